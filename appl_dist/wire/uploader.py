"""Acked uploads, the actor's side: a thread that drains the spool, one rollout at a time, in order.

Stop and wait is enough: a round trip takes well under a millisecond on a cluster and an episode takes
seconds to drive. The other end is `upload.UploadServer`.
"""

from __future__ import annotations

import logging
import threading
import time
from collections import Counter
from collections.abc import Callable
from typing import Protocol

from appl_dist.errors import PassingFault, UserError
from appl_dist.wire import key_expressions as keys
from appl_dist.wire.bus import Bus
from appl_dist.wire.codec import (
    MAX_HEADER_BYTES,
    Ack,
    UploadHeader,
    decode_header,
    encode_header,
    sizes_in,
)

log = logging.getLogger(__name__)

_BACKOFF_S = (0.1, 2.0)  # first and longest wait after an upload without an answer


class SpoolLike(Protocol):
    """What is needed of `actor.spool.Spool`, which describes it."""

    @property
    def oldest(self) -> int: ...
    def __len__(self) -> int: ...
    def peek(self, timeout_s: float) -> tuple[int, bytes] | None: ...
    def ack(self, seq: int) -> None: ...
    def align(self, expected: int) -> None: ...
    def stop(self, reason: str = "") -> None: ...
    def wait_empty(self, timeout_s: float) -> bool: ...


class Uploader:
    """Uploads what is in `spool` as `actor_id`, from `start` to `close`.

    A refusal ends it: the spool is stopped with the reason, so the actor's next `put` raises it; what is
    pending stays on disk. `counts`: welcome (hellos accepted), sent, acked, duplicate, busy, unanswered,
    hello (sent back to say it again).
    timeout_s: how long to wait for one answer, s.
    """

    def __init__(
        self,
        bus: Bus,
        run_id: str,
        actor_id: str,
        spool: SpoolLike,
        *,
        timeout_s: float = 5.0,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self.run_id = keys.check_name("run_id", run_id)
        self.actor_id = keys.check_name("actor_id", actor_id)
        self.counts: Counter[str] = Counter()
        self.refused = ""
        self.held = False  # the learner's last word was to wait
        self._bus = bus
        self._spool = spool
        self._timeout_s = timeout_s
        self._clock = clock
        self._away_since_s: float | None = None
        self._epoch = 0
        self._greeted = False
        self._wait_s = _BACKOFF_S[0]
        self._closing = threading.Event()
        self._claim = bus.announce(keys.claim(run_id, actor_id, bus.identity))
        self._thread = threading.Thread(target=self._run, name="uploader", daemon=True)

    def start(self, timeout_s: float = 10.0, stop: Callable[[], bool] = lambda: False) -> None:
        """Greet the learner, agree on the next sequence number, then upload in the background.

        UserError: refused, or no learner answered within `timeout_s`. Returns early if `stop()`.
        """
        deadline = self._clock() + timeout_s
        while not self._greeted and not stop():
            self._greeted = self._hello()
            if self.refused:
                raise UserError(self.refused)
            if self._clock() > deadline:
                raise PassingFault(f"no learner of run {self.run_id} answered within {timeout_s:g} s")
            if not self._greeted:
                self._closing.wait(0.1)
        self._thread.start()

    def close(self, drain_s: float = 0.0) -> bool:
        """Stop, after waiting up to `drain_s` for the last acks. Whether everything was acked."""
        drained = self._spool.wait_empty(drain_s)
        self._closing.set()
        self._spool.stop()
        if self._thread.is_alive():
            self._thread.join(timeout=self._timeout_s + 1.0)
        self._claim.close()
        return drained

    def step(self) -> float:
        """One turn: greet the learner or upload the oldest rollout. Returns how long to wait next, s."""
        if not self._greeted:
            self._greeted = self._hello()
            return 0.0 if self._greeted else self._back_off()
        head = self._spool.peek(timeout_s=0.0)
        if head is None:
            return 0.0
        ack = self._send(*head)
        self.held = ack is not None and ack.status == "busy"
        if ack is None:
            return self._back_off()
        self._wait_s = _BACKOFF_S[0]
        if self.held:
            return ack.retry_s
        if ack.status in ("stored", "duplicate"):
            self._spool.ack(head[0])
        elif ack.status == "hello":
            self._greeted = False
        else:
            self._refuse(ack.reason)
        return 0.0

    def _run(self) -> None:
        try:
            while not self._closing.is_set() and not self.refused:
                if not self._greeted or self._spool.peek(timeout_s=0.5) is not None:
                    self._closing.wait(self.step())
        except Exception as error:  # what the disk says must reach the actor, whose next put raises it
            if not isinstance(error, UserError):
                log.exception("uploading failed")
            self._refuse(str(error))

    def _back_off(self) -> float:
        wait_s, self._wait_s = self._wait_s, min(2 * self._wait_s, _BACKOFF_S[1])
        return wait_s

    def _send(self, seq: int, blob: bytes) -> Ack | None:
        self.counts["sent"] += 1
        header = UploadHeader(
            self.run_id, self.actor_id, self._bus.identity, self._epoch, seq, sizes_in(blob).transitions
        )
        ack = self._ask(header, blob)
        self.counts["unanswered" if ack is None else "acked" if ack.status == "stored" else ack.status] += 1
        return ack

    def _hello(self) -> bool:
        """Whether the learner knows this process now and the spool is aligned with what it expects."""
        header = UploadHeader(
            self.run_id, self.actor_id, self._bus.identity, self._epoch, self._spool.oldest, 0, hello=True
        )
        ack = self._ask(header, b"")
        if ack is None or ack.status == "busy":
            return False
        if ack.status != "welcome":
            self._refuse(ack.reason)
            return False
        self.counts["welcome"] += 1
        if ack.expected < header.seq:
            log.warning(
                "the learner came back without the %d rollouts it acked last of actor %s",
                header.seq - ack.expected,
                self.actor_id,
            )
        self._epoch = ack.epoch
        self._spool.align(ack.expected)
        return True

    def _ask(self, header: UploadHeader, blob: bytes) -> Ack | None:
        key = keys.upload(self.run_id, self.actor_id)
        answer = self._bus.get(key, blob, encode_header(header), self._timeout_s)
        self._tell_presence(answer is not None)
        if answer is None or answer.size > MAX_HEADER_BYTES:
            return None
        try:
            return decode_header(Ack, answer.payload)
        except ValueError as error:
            self._refuse(f"the learner's answer cannot be read: {error}")
            return None

    def _tell_presence(self, answered: bool) -> None:
        """Say when the learner goes and when it comes back, once each."""
        if not answered and self._away_since_s is None:
            self._away_since_s = self._clock()
            if self._greeted:
                log.warning("the learner does not answer; rollouts go on into the spool (%d there)", len(self._spool))
        elif answered and self._away_since_s is not None:
            away_s, self._away_since_s = self._clock() - self._away_since_s, None
            log.info("the learner answers again after %.1f s; %d rollouts to send", away_s, len(self._spool))

    def _refuse(self, reason: str) -> None:
        self.refused = self.refused or reason or "refused by the learner"
        self._spool.stop(self.refused)
