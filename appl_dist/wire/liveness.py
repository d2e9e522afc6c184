"""Who takes part in a run, and how each one is doing.

A token says that a process is there; it goes within milliseconds of a kill and within the lease when the
process freezes or its network is cut. A hung loop keeps its token, so each loop also reports its progress
once a second: how long ago it did tells the two apart.
"""

from __future__ import annotations

import logging
import threading
import time
from collections import Counter
from collections.abc import Callable
from dataclasses import asdict, dataclass, field

from appl_dist.spec import WIRE_VERSION
from appl_dist.wire import key_expressions as keys
from appl_dist.wire.bus import Bus, Message
from appl_dist.wire.codec import pack, unpack_map
from appl_dist.wire.run_status import Progress
from appl_dist.wire.typed import decode
from appl_dist.wire.wire_settings import MAX_CONNECTIONS

log = logging.getLogger(__name__)

MAX_PROGRESS_BYTES = 16 << 10
_MAX_INCARNATIONS = 16  # live processes counted under one id


class Presence:
    """This process's place in a run: a token from now to `close`, progress when `beat`.

    role: "actor", "learner", "viewer", …. clock: seconds, monotonic.
    """

    def __init__(
        self,
        bus: Bus,
        run_id: str,
        role: str,
        member_id: str,
        *,
        period_s: float = 1.0,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        for name, value in (("run_id", run_id), ("role", role), ("member_id", member_id)):
            keys.check_name(name, value)
        self._bus = bus
        self._key = keys.progress(run_id, role, member_id)
        self._period_s = period_s
        self._clock = clock
        self._last_s = float("-inf")
        self._token = bus.announce(keys.alive(run_id, role, member_id, bus.identity))

    def beat(self, progress: Progress) -> bool:
        """Report how far this process is; whether it was sent.

        Call it as often as the loop turns: at most one report a `period_s` goes out. Never waits.
        """
        now_s = self._clock()
        if now_s - self._last_s < self._period_s:
            return False
        self._last_s = now_s
        data = pack({"wire": WIRE_VERSION, "incarnation": self._bus.identity, "progress": asdict(progress)})
        self._bus.put(self._key, data)
        return True

    def close(self) -> None:
        self._token.close()


@dataclass(frozen=True)
class Member:
    """One process of a run. `silent_s`: since it was last heard of, s; inf before its first report.

    `rate` is transitions per second between its last two reports; `progress` is None before the first.
    """

    role: str
    member_id: str
    incarnation: str
    alive: bool
    silent_s: float
    rate: float
    progress: Progress | None = None


@dataclass
class _Record:
    incarnations: set[str] = field(default_factory=set)
    reporter: str = ""
    heard_s: float = float("-inf")
    rate: float = 0.0
    progress: Progress | None = None


class Roster:
    """All members of a run, there or gone. Bounded: gone members are forgotten first. `counts`: malformed."""

    def __init__(self, bus: Bus, run_id: str, clock: Callable[[], float] = time.monotonic) -> None:
        keys.check_name("run_id", run_id)
        self.counts: Counter[str] = Counter()
        self._clock = clock
        self._lock = threading.Lock()
        self._records: dict[tuple[str, str], _Record] = {}
        self._subscription = bus.subscribe(keys.progress(run_id, keys.ANY, keys.ANY), self._heard)
        self._watch = bus.watch(keys.alive(run_id, keys.ANY, keys.ANY, keys.ANY), self._seen)

    def members(self) -> list[Member]:
        """Sorted by role and id; several live processes of one id show as one."""
        now_s = self._clock()
        with self._lock:
            return [
                Member(
                    role,
                    member_id,
                    record.reporter,
                    bool(record.incarnations),
                    now_s - record.heard_s,
                    record.rate,
                    record.progress,
                )
                for (role, member_id), record in sorted(self._records.items())
            ]

    def close(self) -> None:
        self._subscription.close()
        self._watch.close()

    def _record(self, role: str, member_id: str) -> _Record | None:
        record = self._records.get((role, member_id))
        if record is None:
            if len(self._records) >= MAX_CONNECTIONS:
                gone = next((key for key, old in self._records.items() if not old.incarnations), None)
                if gone is None:
                    return None
                del self._records[gone]
            record = self._records[role, member_id] = _Record()
        return record

    def _seen(self, key: str, present: bool) -> None:
        *_, role, member_id, incarnation = key.split("/")
        if not all(keys.is_name(name) for name in (role, member_id, incarnation)):
            self.counts["malformed"] += 1
            return
        with self._lock:
            record = self._record(role, member_id)
            if record is None:
                return
            if present and len(record.incarnations) < _MAX_INCARNATIONS:
                record.incarnations.add(incarnation)
                record.reporter = record.reporter or incarnation
            elif not present:
                record.incarnations.discard(incarnation)

    def _heard(self, message: Message) -> None:
        try:
            if message.size > MAX_PROGRESS_BYTES:
                raise ValueError(f"{message.size} bytes; allowed up to {MAX_PROGRESS_BYTES}")
            values = unpack_map(message.payload, MAX_PROGRESS_BYTES)
            incarnation = values.get("incarnation")
            *_, role, member_id = message.key.split("/")
            keys.check_name("role", role)
            keys.check_name("member_id", member_id)
            if values.get("wire") != WIRE_VERSION or not keys.is_name(incarnation):
                raise ValueError(f"wire version {values.get('wire')!r:.40}, incarnation {incarnation!r:.80}")
            progress = decode(Progress, values.get("progress"))
        except ValueError as error:
            self.counts["malformed"] += 1
            if self.counts["malformed"] == 1:
                log.warning("ignoring progress on %r: %s", message.key, error)
            return
        now_s = self._clock()
        with self._lock:
            record = self._record(role, member_id)
            if record is None:
                return
            record.rate = _rate(record, str(incarnation), progress, now_s)
            record.reporter = str(incarnation)
            record.heard_s = now_s
            record.progress = progress


def _rate(record: _Record, incarnation: str, progress: Progress, now_s: float) -> float:
    """Transitions per second since the last report of the same process; 0 where there is none."""
    if record.reporter != incarnation or record.progress is None:
        return 0.0
    return max(progress.transitions - record.progress.transitions, 0) / max(now_s - record.heard_s, 1e-3)
