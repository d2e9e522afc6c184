"""An actor's own account: one line for each rollout it ever put into its spool, appended before it can be sent.

A line holds: number, number of its first transition, transitions, sequence number on the wire, digest. Rollouts are
numbered 0, 1, 2, … and so are their transitions. A rollout that gets another sequence number later (see
`Spool.align`) gets another line with its old number; the last line of a number holds.
"""

from __future__ import annotations

import errno
import os
from collections.abc import Iterable
from dataclasses import dataclass, replace
from pathlib import Path

from appl_dist.errors import UserError
from appl_dist.wire.receipt import Receipt

FILE = "produced.log"


@dataclass(frozen=True)
class Produced:
    """One rollout. `first`: the number of its first transition among all of this actor's."""

    number: int
    first: int
    transitions: int
    seq: int
    digest: str

    def line(self) -> bytes:
        return f"{self.number} {self.first} {self.transitions} {self.seq} {self.digest}\n".encode()


def read_produced(path: Path) -> list[Produced]:
    """What the log says, one entry a rollout, in order; a torn last line is left out. UserError: damaged."""
    try:
        data = path.read_bytes() if path.exists() else b""
    except OSError as error:
        raise UserError(f"{path}: cannot be read ({error.strerror})") from None
    entries: dict[int, Produced] = {}
    for text in data.split(b"\n")[:-1]:
        try:
            number, first, transitions, seq, digest = text.split(b" ")
            entry = Produced(int(number), int(first), int(transitions), int(seq), digest.decode())
        except ValueError:
            raise UserError(f"{path}: line {text[:80]!r} is damaged") from None
        entries[entry.number] = entry
    return list(entries.values())


class ProducedLog:
    """The log of one spool folder, appended by the process that owns the folder.

    pending: sequence number → receipt of every rollout in the spool; what the log lacks of them (its writer was
    killed between the two writes) is added.
    """

    def __init__(self, folder: Path, pending: dict[int, Receipt], sync: bool = False) -> None:
        path, self._sync = folder / FILE, sync
        entries = read_produced(path)
        by_digest = {entry.digest: entry for entry in entries}
        self._file = os.open(path, os.O_RDWR | os.O_CREAT | os.O_APPEND | os.O_CLOEXEC, 0o644)
        self._cut_torn_line()
        self.rollouts = len(entries)
        self.transitions = sum(entry.transitions for entry in entries)
        self._pending: dict[int, Produced] = {}
        for seq, receipt in pending.items():
            known = by_digest.get(receipt.digest)
            if known is None:
                self.add(seq, receipt)
            else:
                self._pending[seq] = known
                self.renumber(((seq, seq),))

    def add(self, seq: int, receipt: Receipt) -> None:
        """A new rollout."""
        entry = Produced(self.rollouts, self.transitions, receipt.transitions, seq, receipt.digest)
        self._append(entry)
        self._pending[seq] = entry
        self.rollouts += 1
        self.transitions += receipt.transitions

    def acked(self, seq: int) -> None:
        self._pending.pop(seq, None)

    def renumber(self, moves: Iterable[tuple[int, int]]) -> None:
        """Pending rollouts that have other sequence numbers now: (old, new), ascending."""
        moved = {new: self._pending.pop(old) for old, new in moves}
        for new, entry in moved.items():
            if entry.seq != new:
                moved[new] = replace(entry, seq=new)
                self._append(moved[new])
        self._pending.update(moved)

    def close(self) -> None:
        if self._file >= 0:
            os.close(self._file)
            self._file = -1

    def _append(self, entry: Produced) -> None:
        size, line = os.fstat(self._file).st_size, entry.line()
        if os.write(self._file, line) != len(line):
            os.ftruncate(self._file, size)
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        if self._sync:
            os.fdatasync(self._file)

    def _cut_torn_line(self) -> None:
        size = os.fstat(self._file).st_size
        tail = os.pread(self._file, 256, max(size - 256, 0))
        os.ftruncate(self._file, size - len(tail) + tail.rfind(b"\n") + 1)
