"""Rollouts on their way to the learner, kept on disk until it has them.

One file a rollout, named by sequence number and written atomically, so a killed actor loses only the episode
it was driving. Bounded in count and bytes: a full spool blocks `put`, which is how a slow or absent learner
holds its actors back. One process at a time owns a folder. `produced.log` beside them accounts for every
rollout that ever was in it (`produced_log.py`).

A file is a CRC-32 and the blob. Unless `sync` is wanted files outlive the process, not a power cut; a file that one
tore is found by its checksum at the next start and dropped.
"""

from __future__ import annotations

import json
import logging
import os
import struct
import threading
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

from appl_dist.actor.produced_log import ProducedLog
from appl_dist.errors import UserError
from appl_dist.files import explain, lock, write_atomic
from appl_dist.terminal import printable
from appl_dist.wire import receipt as receipts
from appl_dist.wire.receipt import Receipt

log = logging.getLogger(__name__)

_SUFFIX = ".rollout"
_COUNTER = "spool.json"
_PASSING = "passing"  # noted in the lock file
_CRC = struct.Struct("<I")


class SpoolInUse(UserError):
    """A running process has the folder. passing: only to send what is in it, so it will be free soon."""

    def __init__(self, message: str, passing: bool = False) -> None:
        super().__init__(message)
        self.passing = passing


def has_rollouts(folder: Path) -> bool:
    """Whether unacknowledged rollouts lie in a spool folder."""
    return any(folder.glob(f"*{_SUFFIX}"))


def owner_of(folder: Path) -> str:
    """The owner of a spool folder, "RUN/ACTOR". UserError: not a spool folder, or damaged."""
    try:
        return str(json.loads((folder / _COUNTER).read_bytes())["owner"])
    except (OSError, ValueError, TypeError, KeyError) as error:
        raise UserError(f"{folder}: not a spool folder ({error})") from None


class Spool:
    """A durable bounded queue of blobs numbered 0, 1, 2, …; first in, first out.

    owner: whose rollouts these are, such as "RUN/ACTOR"; a folder of another owner is refused.
    receipt: what the log notes of a blob. sync: what is put is on the disk before it can be sent.
    passing: the folder is opened for a moment, to send what another process left in it.
    UserError: folder taken by a running process (SpoolInUse), of another owner, not writable or out of space.
    """

    def __init__(
        self,
        folder: str | Path,
        owner: str,
        max_count: int = 256,
        max_bytes: int = 256 << 20,
        receipt: Callable[[bytes], Receipt] = receipts.of_blob,
        sync: bool = False,
        passing: bool = False,
    ) -> None:
        if max_count < 1 or max_bytes < 1:
            raise ValueError(f"max_count, max_bytes: got {max_count}, {max_bytes}; allowed 1 and up")
        self.folder = Path(folder)
        self.owner = owner
        self._max_count = max_count
        self._max_bytes = max_bytes
        self._receipt = receipt
        self._sync = sync
        self._full = False  # and said so
        self._changed = threading.Condition()
        self._stopped = False
        self._reason = ""
        try:
            self.folder.mkdir(parents=True, exist_ok=True)
            self._lock_file = _lock(self.folder, _PASSING if passing else "")
        except OSError as error:
            raise self._cannot_write(error) from error
        try:
            self._next = self._read_counter()
            self._sizes, pending = self._recover()  # pending sequence numbers → bytes, ascending
            self._log = ProducedLog(self.folder, pending, sync)
        except OSError as error:
            os.close(self._lock_file)
            raise self._cannot_write(error) from error
        except BaseException:
            os.close(self._lock_file)
            raise
        self._next = max(self._next, *(seq + 1 for seq in self._sizes), 0)

    @property
    def produced(self) -> int:
        """Transitions ever put, by every process that owned the folder."""
        with self._changed:
            return self._log.transitions

    def __len__(self) -> int:
        """Rollouts not yet acked."""
        with self._changed:
            return len(self._sizes)

    @property
    def pending_bytes(self) -> int:
        with self._changed:
            return sum(self._sizes.values())

    @property
    def next_seq(self) -> int:
        with self._changed:
            return self._next

    @property
    def oldest(self) -> int:
        """Sequence number of the oldest pending rollout; `next_seq` when there is none."""
        with self._changed:
            return next(iter(self._sizes), self._next)

    def put(self, blob: bytes, timeout_s: float | None = None, beyond: bool = False) -> int | None:
        """Store `blob` durably and return its sequence number; blocks while the spool is full.

        beyond: store it even so, for an actor that has to end and will not lose its last episode.
        None: stopped, or still full after `timeout_s`; nothing was stored. UserError: the disk refused, or
        the learner did (see `stop`).
        """
        if len(blob) > self._max_bytes:
            raise ValueError(f"blob: got {len(blob)} bytes; the spool holds up to {self._max_bytes}")
        with self._changed:
            if not (beyond or self._has_room(len(blob))):
                self._tell_full()
                self._changed.wait_for(lambda: self._stopped or self._has_room(len(blob)), timeout_s)
            if self._reason:
                raise UserError(self._reason)
            if self._stopped or not (beyond or self._has_room(len(blob))):
                return None
            seq, data = self._next, _CRC.pack(zlib.crc32(blob)) + blob
            self._write(self._path(seq), data)
            try:
                self._log.add(seq, self._receipt(blob))  # before anyone can send it
            except BaseException as error:
                self._path(seq).unlink()
                raise self._cannot_write(error) if isinstance(error, OSError) else error from None
            self._sizes[seq] = len(blob)
            self._next = seq + 1
            self._changed.notify_all()
            return seq

    def peek(self, timeout_s: float = 0.0) -> tuple[int, bytes] | None:
        """(seq, blob) of the oldest pending rollout; None if none came within `timeout_s` or `stop`."""
        with self._changed:
            self._changed.wait_for(lambda: self._stopped or bool(self._sizes), timeout_s)
            if not self._sizes:
                return None
            seq = next(iter(self._sizes))
            return seq, self._path(seq).read_bytes()[_CRC.size :]

    def ack(self, seq: int) -> None:
        """The learner has rollout `seq`, the oldest: forget it."""
        with self._changed:
            if seq != next(iter(self._sizes), None):
                raise ValueError(f"seq: got {seq}; only the oldest pending rollout can be acked")
            self._remove(seq)
            if len(self._sizes) <= self._max_count // 2:
                self._full = False  # from here on it is news again
            self._changed.notify_all()

    def align(self, expected: int) -> None:
        """Make the pending rollouts start at `expected`, the number the learner waits for.

        Below it: acked, but the actor died before it forgot them; dropped. A gap above it: the learner came
        back with older files, or a torn file was dropped; the rest is renumbered, which is safe because the
        learner has none of them. Running this again after a crash inside it ends the same way.
        UserError: the learner is ahead of everything this spool ever numbered, yet rollouts are pending, so
        they were numbered by something else than what the learner knows.
        """
        with self._changed:
            if expected > self._next and self._sizes:
                raise UserError(
                    f"spool {self.folder}: holds rollouts up to number {self._next - 1}, but the learner "
                    f"already has {expected} of {self.owner}; the folder comes from a backup, or another "
                    "machine used this actor id; give this actor another id or empty the folder"
                )
            for seq in [seq for seq in self._sizes if seq < expected]:
                self._remove(seq)
            renumbered: dict[int, int] = {}
            for new, (seq, size) in enumerate(self._sizes.items(), expected):
                if new != seq:
                    os.replace(self._path(seq), self._path(new))
                renumbered[new] = size
            self._log.renumber(zip(self._sizes, renumbered, strict=True))
            self._sizes = renumbered
            if self._next != expected + len(renumbered):
                self._next = expected + len(renumbered)
                self._write_counter()
            self._changed.notify_all()

    def stop(self, reason: str = "") -> None:
        """Wake and end every wait. With a `reason`, further `put`s raise it as a UserError."""
        with self._changed:
            self._stopped = True
            self._reason = self._reason or reason
            self._changed.notify_all()

    def wait_empty(self, timeout_s: float) -> bool:
        """Whether everything was acked within `timeout_s` (and before a `stop`)."""
        with self._changed:
            self._changed.wait_for(lambda: self._stopped or not self._sizes, timeout_s)
            return not self._sizes

    def close(self) -> None:
        """Release the folder; pending rollouts stay for the next process."""
        self.stop()
        with self._changed:
            if self._lock_file >= 0:
                self._log.close()
                os.close(self._lock_file)
                self._lock_file = -1

    def __enter__(self) -> Spool:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _has_room(self, size: int) -> bool:
        if not self._sizes:
            return True
        return len(self._sizes) < self._max_count and sum(self._sizes.values()) + size <= self._max_bytes

    def _remove(self, seq: int) -> None:
        if len(self._sizes) == 1:  # the last file no longer tells the next number: write it down first
            self._write_counter()
        self._path(seq).unlink(missing_ok=True)
        del self._sizes[seq]
        self._log.acked(seq)

    def _tell_full(self) -> None:
        if not self._full:
            self._full = True
            log.warning(
                "spool %s is full (%d rollouts, %.0f MB): collecting waits until the learner has taken some",
                self.folder, len(self._sizes), sum(self._sizes.values()) / 1e6,
            )  # fmt: skip

    def _path(self, seq: int) -> Path:
        return self.folder / f"{seq:012d}{_SUFFIX}"

    def _recover(self) -> tuple[dict[int, int], dict[int, Receipt]]:
        """(bytes, receipt) of every pending rollout by sequence number, ascending."""
        sizes: dict[int, int] = {}
        pending: dict[int, Receipt] = {}
        for leftover in self.folder.glob("*.tmp"):
            leftover.unlink()
        for path in sorted(self.folder.glob(f"*{_SUFFIX}")):
            data = path.read_bytes()
            if len(data) < _CRC.size or zlib.crc32(memoryview(data)[4:]) != _CRC.unpack_from(data)[0]:
                log.warning("%s is damaged; dropping it", path)
                path.unlink()
                continue
            seq = int(path.name.removesuffix(_SUFFIX))
            sizes[seq] = len(data) - _CRC.size
            pending[seq] = self._receipt(data[_CRC.size :])
        return sizes, pending

    def _read_counter(self) -> int:
        path = self.folder / _COUNTER
        if not path.exists():
            self._next = 0
            self._write_counter()
            return 0
        try:
            values: dict[str, Any] = json.loads(path.read_bytes())
            owner, following = str(values["owner"]), int(values["next_seq"])
        except (ValueError, TypeError, KeyError) as error:
            raise UserError(f"{path}: damaged ({error}); remove the folder to start this actor anew") from error
        if owner != self.owner:
            raise UserError(f"spool {self.folder}: belongs to {owner}, not to {self.owner}; use another folder")
        return following

    def _write_counter(self) -> None:
        values = {"owner": self.owner, "next_seq": self._next}
        self._write(self.folder / _COUNTER, json.dumps(values).encode())

    def _write(self, path: Path, data: bytes) -> None:
        write_atomic(path, data, sync=self._sync)

    def _cannot_write(self, error: OSError) -> UserError:
        return UserError(f"spool {self.folder}: cannot be written: {explain(error)}")


def _lock(folder: Path, note: str) -> int:
    """A descriptor holding the folder's lock; the kernel drops it with the process, however that ends.

    note: what others read in the lock file, beside the process.
    """
    descriptor = os.open(folder / "lock", os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o644)
    holder, _, noted = printable(os.pread(descriptor, 64, 0).decode(errors="replace").strip()).partition(" ")
    holder = holder or "unknown"
    held = f"spool {folder}: in use by process {holder}; two actors cannot share a folder, give each its own id"
    try:
        lock(descriptor, folder / "lock", held)
    except UserError as error:
        os.close(descriptor)
        raise (SpoolInUse(held, noted == _PASSING) if str(error) == held else error) from None
    os.truncate(descriptor, 0)
    os.pwrite(descriptor, f"{os.getpid()} {note}\n".encode(), 0)
    return descriptor
