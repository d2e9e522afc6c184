"""The ring that holds replay's rollouts: one run of rows each, in files or in memory, never half there.

A rollout of n transitions takes n + 1 consecutive rows, the last holding only the final observation. Durable against
kill -9 at any instruction: evict (one counter), rows, index entry, then one aligned 8-byte store of the rollout count
commits. What is not counted was never there; what was acknowledged is. With `sync` each of these steps is on the disk
before the next, which makes it durable against a power cut. The expected sequence number of every actor comes from the
index, and from a floor kept per actor for rollouts the ring has overwritten.
"""

from __future__ import annotations

import math
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from appl_dist.errors import UserError
from appl_dist.learner.mapped_file import FolderClaim, MappedArray
from appl_dist.learner.row_layout import RowLayout
from appl_dist.learner.sum_tree import Priorities
from appl_dist.spec import FloatArray, Rollout

FORMAT = 1
MAX_ACTORS = 1 << 16
_ACTOR_ID_BYTES = 64
_FILES = ("rows.bin", "index.bin", "actors.bin", "header.bin")

_HEADER = np.dtype([("inserted", "<i8"), ("evicted", "<i8"), ("actors", "<i8")])
_ENTRY = np.dtype(
    [
        ("seq", "<i8"),
        ("start", "<i8"),  # virtual row: grows for ever, row in the file = start % rows
        ("total", "<i8"),  # transitions ever inserted, this rollout's included
        ("length", "<u4"),  # transitions; length + 1 rows
        ("actor", "<u4"),
    ]
)
_ACTOR = np.dtype([("id", f"S{_ACTOR_ID_BYTES}"), ("floor", "<i8")])  # floor: sequence numbers below are evicted


@dataclass(frozen=True)
class Stored:
    """One rollout as replay holds it, without its scans: other (n + 1, k) of the observations, actions (n, a),
    rewards (n,).
    """

    actor: str
    seq: int
    other: FloatArray
    actions: FloatArray
    rewards: FloatArray


def rows_for(capacity: int) -> int:
    """Rows of a ring for so many transitions in rollouts of 16 and more; shorter ones fill it earlier."""
    return capacity + capacity // 16 + 1


class Ring:
    """Rollouts in order of arrival, the oldest evicted first: at most `capacity` transitions.

    `priorities` is told which rows hold transitions; its size is `rows_for(capacity)`. sync: `insert` returns when the
    rollout is on the disk. UserError if `folder` holds a replay of another shape, is in use, or its disk is full.
    """

    def __init__(
        self, folder: str | Path | None, capacity: int, layout: RowLayout, priorities: Priorities | None, sync: bool
    ) -> None:
        self.capacity, self.layout = capacity, layout
        self._priorities, self._sync = priorities, sync
        self._rows_count = rows_for(capacity)
        self.folder = None if folder is None else Path(folder)
        self._claim = None if self.folder is None else FolderClaim(self.folder, self._meta(), _FILES)
        self._rows = self._array("rows.bin", self.layout.dtype, self._rows_count)
        self._index = self._array("index.bin", _ENTRY, self._rows_count // 2 + 1)  # a rollout has >= 2 rows
        self._actors = self._array("actors.bin", _ACTOR, MAX_ACTORS)
        self._header = self._array("header.bin", _HEADER, 1)
        self._header.claim(0, 1)
        self._head = self._tail = self._total = self._stored = 0  # virtual rows; transitions
        self._slots: dict[str, int] = {}  # actor id -> record in actors.bin
        self._expected: dict[str, int] = {}
        self._write_lock = threading.Lock()  # one insert at a time
        self._lock = threading.Lock()  # what sampling reads is still, held for the copy only
        self._recover()
        if self._claim is not None:
            self._claim.complete()

    def __len__(self) -> int:
        """Transitions that can be sampled."""
        return self._stored

    @property
    def transitions_total(self) -> int:
        """Transitions ever inserted: the clock of schedules and of the samples-per-insert limiter."""
        return self._total

    @property
    def rollouts_total(self) -> int:
        """Rollouts ever inserted."""
        return int(self._header.data["inserted"][0])

    @property
    def actors(self) -> frozenset[str]:
        """Ids of all actors whose rollouts were ever inserted."""
        return frozenset(self._expected)

    def expected_seq(self, actor_id: str) -> int:
        """The sequence number `insert` takes next from this actor; 0 for one never seen."""
        return self._expected.get(actor_id, 0)

    def rollouts(self) -> list[Stored]:
        """Every rollout it still holds, oldest first; views of its own memory."""
        names = {slot: name for name, slot in self._slots.items()}
        found = []
        for number in range(int(self._header.data["evicted"][0]), self.rollouts_total):
            entry = self._index.data[number % len(self._index.data)]
            n, start = int(entry["length"]), int(entry["start"]) % self._rows_count
            rows = self._rows.data[start : start + n + 1]
            actor, seq = names[int(entry["actor"])], int(entry["seq"])
            found.append(Stored(actor, seq, rows["other"], rows["action"][:n], rows["reward"][:n]))
        return found

    # ---- out

    @contextmanager
    def reading(self) -> Iterator[NDArray[Any]]:
        """The rows, a structured array of `layout.dtype`, which nothing changes meanwhile: for copies, not for long."""
        with self._lock:
            yield self._rows.data

    def draw(self, batch: int, rng: np.random.Generator) -> NDArray[np.int64]:
        """(b,) rows of stored transitions, uniform over them; call it while `reading`, of a ring that is not empty.

        Uniform over live rows, last observations rejected.
        """
        live = self._head - self._tail
        left = self._rows.data["left"]
        kept = np.empty(0, np.int64)
        while len(kept) < batch:
            # Two percent over the mean need: a second round is rare, and harmless.
            size = math.ceil((batch - len(kept)) * live / self._stored * 1.02) + 8
            rows = (self._tail + rng.integers(live, size=size)) % self._rows_count
            kept = np.concatenate((kept, rows[left[rows] > 0]))
        return kept[:batch]

    # ---- in

    def insert(self, rollout: Rollout, actor_id: str, seq: int) -> bool:
        """Store a rollout; on return it survives kill -9, with `sync` a power cut too. False: a repeat, already stored.

        ValueError: a rollout that cannot be, or a gap in the sequence. UserError: no room on disk; nothing
        changed, so the same call can be repeated.
        """
        with self._write_lock:
            expected = self.expected_seq(actor_id)
            if seq < expected:
                return False
            if seq > expected:
                raise ValueError(f"actor {actor_id!r}: got rollout {seq}; expected {expected}")
            rows = self.layout.pack(rollout, self.capacity)
            slot = self._actor_slot(actor_id)
            self._append(rows, slot, seq)
            self._expected[actor_id] = seq + 1
            return True

    def _actor_slot(self, actor_id: str) -> int:
        slot = self._slots.get(actor_id)
        if slot is not None:
            return slot
        name = actor_id.encode()
        if not 1 <= len(name) <= _ACTOR_ID_BYTES or b"\0" in name:
            raise ValueError(f"actor id {actor_id!r}: got {len(name)} bytes; allowed 1..{_ACTOR_ID_BYTES}, no NUL")
        slot = len(self._slots)
        if slot == MAX_ACTORS:
            raise UserError(f"replay: {MAX_ACTORS} actor ids seen; actors must keep their id when they restart")
        self._actors.claim(slot, slot + 1)
        self._actors.data[slot] = (name, 0)
        self._header.data["actors"][0] = slot + 1
        self._slots[actor_id] = slot
        return slot

    def _append(self, rows: NDArray[Any], slot: int, seq: int) -> None:
        n, ring = len(rows) - 1, self._rows_count
        start = self._head
        gap = ring - start % ring if start % ring + len(rows) > ring else 0  # a rollout never wraps
        begin = (start + gap) % ring
        self._rows.claim(begin, begin + len(rows))
        if gap:
            self._rows.claim(ring - gap, ring)
        entry = self.rollouts_total % len(self._index.data)
        self._index.claim(entry, entry + 1)
        with self._lock:
            self._evict(start + gap + len(rows) - ring, self._stored + n - self.capacity)
            if gap:
                self._rows.data["left"][ring - gap :] = 0
            self._rows.data[begin : begin + len(rows)] = rows
            self._index.data[entry] = (seq, start + gap, self._total + n, n, slot)
            self._to_disk(self._rows, self._index, self._actors)
            self._header.data["inserted"][0] = self.rollouts_total + 1  # the commit
            if self._priorities is not None:
                self._priorities.enter(begin, n)
            self._head = start + gap + len(rows)
            self._tail = self._start_of(int(self._header.data["evicted"][0]))
            self._total += n
            self._stored += n
        self._to_disk(self._header)

    def _to_disk(self, *arrays: MappedArray) -> None:
        if self._sync:
            for array in arrays:
                array.sync()

    def _evict(self, first_row: int, surplus: int) -> None:
        """Drop the oldest rollouts: those that start before virtual row `first_row`, then `surplus` more."""
        inserted, before = self.rollouts_total, int(self._header.data["evicted"][0])
        evicted = before
        while evicted < inserted and (self._tail < first_row or surplus > 0):
            old = self._index.data[evicted % len(self._index.data)]
            self._actors.data["floor"][old["actor"]] = old["seq"] + 1  # before the index can forget it
            evicted += 1
            if self._priorities is not None:
                self._priorities.leave(int(old["start"]) % self._rows_count, int(old["length"]))
            self._stored -= int(old["length"])
            surplus -= int(old["length"])
            self._tail = self._start_of(evicted) if evicted < inserted else self._head
        if evicted > before:
            self._to_disk(self._actors)
            self._header.data["evicted"][0] = evicted
            self._to_disk(self._header)

    def _start_of(self, number: int) -> int:
        return int(self._index.data["start"][number % len(self._index.data)])

    # ---- the folder

    def flush(self) -> None:
        """Wait until everything stored so far would survive a power cut; call it beside a checkpoint."""
        for array in (self._rows, self._index, self._actors, self._header):
            array.sync()

    def close(self) -> None:
        """Let go of the folder; another process may open it. Nothing can be inserted or sampled after."""
        with self._write_lock, self._lock:
            for array in (self._rows, self._index, self._actors, self._header):
                array.close()
            self._stored = 0
            if self._claim is not None:
                self._claim.release()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exc: object) -> None:
        self.close()

    def _array(self, name: str, dtype: np.dtype[Any], length: int) -> MappedArray:
        return MappedArray(None if self.folder is None else self.folder / name, dtype, length)

    def _meta(self) -> dict[str, Any]:
        return {
            "format": FORMAT,
            "capacity": self.capacity,
            "observation_size": self.layout.observation_size,
            "scan_size": self.layout.scan_size,
            "scan_dtype": self.layout.scan_dtype.name,
            "action_size": self.layout.action_size,
        }

    def _recover(self) -> None:
        """Take up what the files hold: counters, positions and each actor's expected sequence number."""
        inserted, evicted, actors = (int(v) for v in self._header.data[0])
        slots = len(self._index.data)
        if not (0 <= evicted <= inserted and inserted - evicted <= slots and 0 <= actors <= MAX_ACTORS):
            raise UserError(f"replay folder {self.folder}: its header is damaged; choose an empty folder")
        live = self._index.data[np.arange(evicted, inserted) % slots]
        ends = live["start"] + live["length"] + 1
        if inserted:
            last = self._index.data[(inserted - 1) % slots]
            self._head = int(last["start"]) + int(last["length"]) + 1
            self._total = int(last["total"])
            self._tail = int(live["start"][0]) if len(live) else self._head
        if (
            (live["actor"] >= actors).any()
            or (live["start"][1:] < ends[:-1]).any()
            or self._head - self._tail > self._rows_count
        ):
            raise UserError(f"replay folder {self.folder}: its index is damaged; choose an empty folder")
        self._stored = int(live["length"].sum())
        floors = self._actors.data["floor"][:actors].copy()
        np.maximum.at(floors, live["actor"], live["seq"] + 1)
        names = [name.decode() for name in self._actors.data["id"][:actors].tolist()]
        self._slots = {name: slot for slot, name in enumerate(names)}
        self._expected = dict(zip(names, floors.tolist(), strict=True))
        if self._priorities is not None:
            for entry in live:
                self._priorities.enter(int(entry["start"]) % self._rows_count, int(entry["length"]))
