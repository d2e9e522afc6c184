"""The live terminal view of a run: what the learner says of itself, once a second."""

from __future__ import annotations

import sys

from rich.console import Console, Group, RenderableType
from rich.markup import escape
from rich.panel import Panel
from rich.progress_bar import ProgressBar
from rich.table import Table

from appl_dist.wire.run_status import RunStatus

PRINTED_WIDTH = 120  # of tables where there is no terminal to ask


def make_console() -> Console:
    """The terminal, or a page wide enough for the tables."""
    return Console(width=None if sys.stdout.isatty() else PRINTED_WIDTH)


def render(status: RunStatus | None, notes: list[str], hint: str = "") -> RenderableType:
    """A panel for one status of the learner (learner/learner.py). notes: lines of the launcher; hint: its foot."""
    if status is None:
        return Panel("waiting for the learner …", title="appl-dist train")
    progress = Table.grid(padding=(0, 2), expand=True)
    progress.add_column(ratio=1)
    progress.add_column(justify="right")
    progress.add_row(
        ProgressBar(total=max(status.run_transitions, 1), completed=status.transitions),
        f"{status.transitions:,} / {status.run_transitions:,} transitions   {_clock(status.elapsed_s)}",
    )
    numbers = Table.grid(padding=(0, 3))
    for _ in range(4):
        numbers.add_column(justify="right", style="dim")
        numbers.add_column()
    numbers.add_row(
        "transitions/s", f"{status.transitions_per_s:.1f}", "updates/s", f"{status.updates_per_s:.1f}",
        "episodes", f"{status.episodes:,}", "samples/insert", f"{status.samples_per_insert:.0f}",
    )  # fmt: skip
    numbers.add_row(
        "success", _percent(status.success), "traversal", _seconds(status.time_s),
        "return", _number(status.return_), "queue", str(status.queue),
    )  # fmt: skip
    numbers.add_row(
        "policy version", str(status.version), "staleness", _stale(status),
        "noise sigma", f"{status.sigma:.3f}", "updates", f"{status.updates:,}",
    )  # fmt: skip
    actors = Table(box=None, header_style="dim", pad_edge=False)
    for column in ("actor", "transitions/s", "world", "policy version", "unsent", "last seen"):
        actors.add_column(column, justify="left" if column == "actor" else "right")
    for a in status.actors:
        actors.add_row(
            escape(a.id), f"{a.transitions_per_s:.1f}", str(a.world), str(a.version), str(a.pending),
            f"{a.silent_s:.0f} s",
        )  # fmt: skip
    rows: list[RenderableType] = [progress, numbers, actors]
    if status.refused:
        senders = ", ".join(f"{sender} ({n:,})" for sender, n in list(status.refused.items())[:3])
        rows.append(f"[yellow]refused messages of {escape(senders)}[/yellow]")
    if status.held_back:
        rows.append(f"[yellow]{escape(status.held_back)}[/yellow]")
    rows += [f"[yellow]{escape(note)}[/yellow]" for note in notes[-3:]]
    return Panel(Group(*rows), title=f"appl-dist · {escape(status.run_id)}", subtitle=escape(hint))


def line(status: RunStatus) -> str:
    """The same in one line, for logs and pipes."""
    return (
        f"{status.transitions:,}/{status.run_transitions:,} transitions "
        f"({status.transitions_per_s:.1f}/s), {status.updates:,} updates ({status.updates_per_s:.1f}/s), "
        f"{status.episodes:,} episodes, success {_percent(status.success)}, "
        f"traversal {_seconds(status.time_s)}, return {_number(status.return_)}, "
        f"policy {status.version}, staleness {_stale(status)}, {len(status.actors)} actors"
    )


def _stale(status: RunStatus) -> str:
    return f"{status.staleness:.1f} versions ({100 * status.stale_share:.0f} % stale)"


def _clock(seconds: float) -> str:
    return f"{int(seconds) // 3600}:{int(seconds) // 60 % 60:02d}:{int(seconds) % 60:02d}"


def _percent(value: float | None) -> str:
    return "-" if value is None else f"{100 * value:.0f} %"


def _seconds(value: float | None) -> str:
    return "-" if value is None else f"{value:.1f} s"


def _number(value: float | None) -> str:
    return "-" if value is None else f"{value:.1f}"
