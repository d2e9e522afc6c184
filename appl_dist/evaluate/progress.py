"""Progress of many trials: a bar with the time left on a terminal, a log line now and then elsewhere."""

from __future__ import annotations

import logging
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

from rich.console import Console
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    TextColumn,
    TimeElapsedColumn,
    TimeRemainingColumn,
)

log = logging.getLogger(__name__)

LOG_EVERY_S = 30.0


@contextmanager
def show_progress(
    total: int,
    title: str,
    console: Console | None = None,
    *,
    done: int = 0,
    clock: Callable[[], float] = time.monotonic,
) -> Iterator[Callable[[Any], None]]:
    """Yields the `on_trial` callback of `run_jobs`; counts `total` trials, `done` of which are there already."""
    console = console or Console(stderr=True)
    if console.is_terminal:
        columns = (
            TextColumn("{task.description}", markup=False),
            BarColumn(),
            MofNCompleteColumn(),
            TextColumn("{task.fields[success]}", markup=False),
            TimeElapsedColumn(),
            TextColumn("left"),
            TimeRemainingColumn(elapsed_when_finished=False),
        )
        with Progress(*columns, console=console, speed_estimate_period=120.0) as bar:
            task = bar.add_task(title, total=total, completed=done, success="")
            count = successes = 0

            def advance(trial: Any) -> None:
                nonlocal count, successes
                count += 1
                successes += trial.success
                bar.update(task, advance=1, success=f"{successes / count:.0%} reach the goal")

            yield advance
        return
    start = last = clock()
    new = 0

    def note(trial: Any) -> None:
        nonlocal new, last
        new += 1
        now = clock()
        if now - last >= LOG_EVERY_S or done + new == total:
            last = now
            left_s = (now - start) / new * (total - done - new)
            log.info("%s: %d of %d trials, about %.0f s left", title, done + new, total, left_s)

    yield note
