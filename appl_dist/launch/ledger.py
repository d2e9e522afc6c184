"""`appl-dist ledger RUN`: is everything the actors produced in replay, once?

Two independent accounts are compared: each actor's log of what it put into its spool, and what replay really holds.
Rollouts still in replay are recognised by a digest of their bytes; those that the ring has overwritten by number.
"""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Iterable
from dataclasses import dataclass, field
from pathlib import Path

from rich.console import Console
from rich.table import Table
from rich.text import Text

from appl_dist.actor.produced_log import FILE, Produced, read_produced
from appl_dist.actor.spool import owner_of
from appl_dist.arguments import ArgumentParser
from appl_dist.errors import UserError
from appl_dist.learner.replay import Replay
from appl_dist.terminal import printable
from appl_dist.wire import receipt


@dataclass
class Account:
    """One actor's transitions. sent: ever put into a spool; stored: of these in replay now or evicted from it;
    waiting: still in a spool; lost: in neither. duplicate: stored more than once. unknown: in replay, but in no log.
    """

    rollouts: int = 0
    sent: int = 0
    stored: int = 0
    waiting: int = 0
    lost: int = 0
    duplicate: int = 0
    unknown: int = 0


@dataclass
class Ledger:
    """All accounts by actor, and replay's own count of transitions ever stored."""

    accounts: dict[str, Account] = field(default_factory=dict)
    replay_total: int = 0

    def total(self) -> Account:
        names = Account.__dataclass_fields__
        return Account(**{name: sum(getattr(a, name) for a in self.accounts.values()) for name in names})

    @property
    def agrees(self) -> bool:
        total = self.total()
        return total.lost == total.duplicate == total.unknown == 0 and total.stored == self.replay_total

    def sentence(self) -> str:
        t = self.total()
        verdict = "the accounts agree" if self.agrees else "THE ACCOUNTS DO NOT AGREE"
        unknown = f", {t.unknown:,} in replay of no log" if t.unknown else ""
        return (
            f"ledger: {len(self.accounts)} actors sent {t.sent:,} transitions; {self.replay_total:,} in replay, "
            f"{t.waiting:,} waiting, lost {t.lost:,}, duplicate {t.duplicate:,}{unknown}: {verdict}"
        )


def audit(replay: Replay, spools: Iterable[Path]) -> Ledger:
    """Compare `replay` with the logs in the spool folders."""
    logs: dict[str, list[Produced]] = defaultdict(list)
    pending: dict[str, set[str]] = defaultdict(set)  # digests
    for folder in spools:
        actor = owner_of(folder).rsplit("/", 1)[-1]
        entries = read_produced(folder / FILE)
        files = {int(path.stem) for path in folder.glob("*.rollout")}
        logs[actor] += entries
        pending[actor] |= {entry.digest for entry in entries if entry.seq in files}
    held: dict[str, list[tuple[int, receipt.Receipt]]] = defaultdict(list)
    for stored in replay.ring.rollouts():
        held[stored.actor].append((stored.seq, receipt.of_arrays(stored.other, stored.actions, stored.rewards)))
    actors = sorted({*logs, *replay.ring.actors})
    return Ledger(
        {a: _account(logs[a], pending[a], held[a], replay.ring.expected_seq(a)) for a in actors},
        replay.ring.transitions_total,
    )


def _account(log: list[Produced], pending: set[str], held: list[tuple[int, receipt.Receipt]], expected: int) -> Account:
    account = Account(rollouts=len(log), sent=sum(entry.transitions for entry in log))
    copies = Counter(found.digest for _, found in held)
    floor = min((seq for seq, _ in held), default=expected)  # numbers below are evicted
    evicted = {entry.seq: entry for entry in log if entry.seq < floor}  # the last to have had a number
    for entry in log:
        if copies[entry.digest] > 0 or evicted.get(entry.seq) is entry:
            account.stored += entry.transitions
        elif entry.digest in pending:
            account.waiting += entry.transitions
        else:
            account.lost += entry.transitions
    known = {entry.digest for entry in log}
    for _, found in held:
        if found.digest not in known:
            account.unknown += found.transitions
        elif copies[found.digest] > 1:
            copies[found.digest] -= 1
            account.duplicate += found.transitions
    return account


def run_ledger(folder: Path, elsewhere: Iterable[Path] = ()) -> Ledger:
    """The ledger of a run folder; `elsewhere` are spool folders, or folders of them, that are not in it."""
    if not (folder / "replay").is_dir():
        raise UserError(f"ledger: {folder} is no run's folder: it holds no replay")
    roots = [folder / "spool", *elsewhere]
    missing = [root for root in roots[1:] if not root.is_dir()]
    if missing:
        raise UserError(f"ledger: no folder at {missing[0]}")
    spools = sorted({path.parent for root in roots for path in root.rglob("spool.json")})
    with Replay.reopen(folder / "replay") as replay:
        return audit(replay, spools)


def main(arguments: list[str], console: Console) -> int:
    """Print the ledger of `RUN [SPOOL …]`; status 0 if the accounts agree."""
    parser = ArgumentParser(prog="appl-dist ledger", description="Compare what actors sent with replay.")
    parser.add_argument("run", type=Path, metavar="RUN", help="a run's folder")
    parser.add_argument("spools", nargs="*", type=Path, metavar="SPOOL_FOLDER", help="of actors that ran elsewhere")
    options = parser.parse_args(arguments)
    ledger = run_ledger(options.run, options.spools)
    table = Table(box=None, header_style="dim")
    for column in ("actor", "rollouts", "sent", "in replay", "waiting", "lost", "duplicate"):
        table.add_column(column, justify="left" if column == "actor" else "right")
    for actor, a in ledger.accounts.items():
        table.add_row(
            Text(printable(actor)),
            *(f"{n:,}" for n in (a.rollouts, a.sent, a.stored + a.unknown, a.waiting, a.lost, a.duplicate)),
        )
    console.print(table)
    console.print(ledger.sentence(), highlight=False, markup=False, soft_wrap=True)
    return 0 if ledger.agrees else 1
