"""From the wire into replay: what is accepted, what is a repeat, what has to wait.

Exactly once: replay itself knows how many rollouts of each actor it holds, so storing a rollout and counting
it are one durable step, and a learner killed between storing and answering recognises the repeat.
"""

from __future__ import annotations

import logging
import threading
from dataclasses import asdict, dataclass
from typing import Protocol

from appl_dist.spec import Rollout
from appl_dist.wire.codec import Ack, UploadHeader

log = logging.getLogger(__name__)

_PROMPT_ACTORS = 16  # up to this many are asked back after `retry_s`, more of them proportionally later
_LONGEST_RETRY_S = 5.0


class ReplayLike(Protocol):
    """What ingest needs of replay. `insert` is durable when it returns."""

    def insert(self, rollout: Rollout, actor_id: str, seq: int) -> object: ...

    def expected_seq(self, actor_id: str) -> int:
        """How many rollouts of this actor are stored: the sequence number of its next."""


class LimiterLike(Protocol):
    """The samples-per-insert limiter."""

    def may_insert(self, transitions: int) -> bool:
        """Whether `transitions` more may enter now, given how much was learned from those before. True counts them."""

    def give_back(self, inserts: int) -> None:
        """Take back a permission whose insert failed."""


@dataclass
class ActorLedger:
    """One actor's account since this learner process started.

    duplicates were acked and not stored again; gaps are rollouts that came ahead of a missing one and were
    sent back; busy counts the times the limiter said wait.
    """

    rollouts: int = 0
    transitions: int = 0
    duplicates: int = 0
    gaps: int = 0
    busy: int = 0


class Ingest:
    """An `UploadSink`: judges each rollout by its sequence number, then stores it.

    retry_s: when to ask again while the limiter holds inserts back, s.
    """

    def __init__(self, replay: ReplayLike, limiter: LimiterLike | None, run_id: str, retry_s: float = 0.25) -> None:
        self.run_id = run_id
        self._replay = replay
        self._limiter = limiter
        self._retry_s = retry_s
        self._lock = threading.Lock()
        self._ledgers: dict[str, ActorLedger] = {}

    def store(self, header: UploadHeader, rollout: Rollout) -> Ack:
        """Ack for `rollout`. Whatever replay raises passes through, and then nothing was acked."""
        if header.run != self.run_id:
            return Ack("refused", reason=f"run: got {header.run}; expected {self.run_id}", epoch=header.epoch)
        expected = self._replay.expected_seq(header.actor)
        with self._lock:
            ledger = self._ledgers.setdefault(header.actor, ActorLedger())
        if header.seq < expected:
            ledger.duplicates += 1
            return Ack("duplicate", expected, epoch=header.epoch)
        if header.seq > expected:
            ledger.gaps += 1
            log.warning("actor %s sent rollout %d; expected %d", header.actor, header.seq, expected)
            return Ack("hello", expected, reason=f"expected rollout {expected}", epoch=header.epoch)
        if self._limiter is not None and not self._limiter.may_insert(len(rollout)):
            ledger.busy += 1
            # Held actors send their rollout again each time: spread a large fleet's questions out.
            retry_s = min(self._retry_s * max(1.0, len(self._ledgers) / _PROMPT_ACTORS), _LONGEST_RETRY_S)
            reason = "learning is behind collecting"
            return Ack("busy", expected, retry_s, reason, epoch=header.epoch)
        try:
            self._replay.insert(rollout, header.actor, header.seq)
        except BaseException:
            if self._limiter is not None:
                self._limiter.give_back(len(rollout))
            raise
        ledger.rollouts += 1
        ledger.transitions += len(rollout)
        return Ack("stored", expected + 1, epoch=header.epoch)

    def expected_seq(self, actor_id: str) -> int:
        return self._replay.expected_seq(actor_id)

    def ledger(self) -> dict[str, dict[str, int]]:
        """Actor id → its `ActorLedger` as a dict; the same numbers that replay's own count must give."""
        with self._lock:
            return {actor: asdict(ledger) for actor, ledger in sorted(self._ledgers.items())}
