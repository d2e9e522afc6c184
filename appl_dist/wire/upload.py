"""Acked uploads, the learner's side: rollouts come in as queries, the answer goes out once they are stored.

At least once on the wire, exactly once in replay: an actor repeats a sequence number until it is acked, the
sink drops what it already has. One worker takes the queries in their order of arrival, so each actor's
rollouts are in order; the queue is bounded and what does not fit is answered "busy". The other end is
`uploader.Uploader`.
"""

from __future__ import annotations

import logging
import threading
import time
from collections import Counter, deque
from collections.abc import Callable
from typing import Protocol

from appl_dist.spec import Rollout
from appl_dist.terminal import printable
from appl_dist.wire import key_expressions as keys
from appl_dist.wire.bus import Bus, Query
from appl_dist.wire.claims import Claims
from appl_dist.wire.codec import (
    MAX_ROLLOUT_BYTES,
    Ack,
    UploadHeader,
    decode_header,
    decode_rollout,
    encode_header,
)
from appl_dist.wire.typed import MAX_TEXT

log = logging.getLogger(__name__)

_WAITING_PER_ACTOR = 2  # an actor has one upload under way; a second is its retry after a time-out
_RETRY_S = 0.5
_FAILED_RETRY_S = 2.0
_STRANGERS = 8  # this part of the queue is open to actors that no process has claimed
_LOGGED_SENDERS = 32
_COUNTED_SENDERS = 1024


class UploadSink(Protocol):
    """Where accepted rollouts go. Called from one thread, in order for each actor."""

    def store(self, header: UploadHeader, rollout: Rollout) -> Ack:
        """Store durably, then say so; or say why not. ValueError: a rollout that can never be stored."""

    def expected_seq(self, actor_id: str) -> int:
        """The next sequence number of this actor."""


class UploadServer:
    """Serves uploads of one run until closed. Nothing received stops it; `counts` says what came.

    epoch: number of this learner process, larger after each restart; actors that greeted another one are
    asked for a new hello. grace_s: see `Claims`.
    """

    def __init__(
        self,
        bus: Bus,
        run_id: str,
        sink: UploadSink,
        *,
        epoch: int = 0,
        grace_s: float = 3.0,
        max_waiting: int = 1024,
        max_waiting_bytes: int = 256 << 20,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self.run_id = keys.check_name("run_id", run_id)
        self.counts: Counter[str] = Counter()  # by status, plus "malformed" and "failed" (the sink raised)
        self._refused: Counter[str] = Counter()  # by sender; those beyond _COUNTED_SENDERS under "others"
        self._sink = sink
        self._epoch = epoch
        self._max_waiting = max_waiting
        self._max_waiting_bytes = max_waiting_bytes
        self._waiting: deque[Query] = deque()
        self._waiting_bytes = 0
        self._waiting_of: Counter[str] = Counter()
        self._changed = threading.Condition()
        self._closed = False
        self._logged: set[str] = set()
        self._claims = Claims(bus, run_id, grace_s, clock)
        self._worker = threading.Thread(target=self._run, name="upload-server", daemon=True)
        self._worker.start()
        # Of every run: an actor of another one is told so, rather than left to time out.
        self._queryable = bus.serve(keys.upload(keys.ANY, keys.ANY), self._receive)

    def close(self) -> None:
        self._queryable.close()
        with self._changed:
            self._closed = True
            self._changed.notify_all()
        self._worker.join(timeout=5.0)
        self._claims.close()

    def refused(self, most: int = 10) -> dict[str, int]:
        """Refusals by sender, RUN/ACTOR as on its key, the `most` refused ones."""
        with self._changed:
            return dict(self._refused.most_common(most))

    def _receive(self, query: Query) -> None:
        """On a thread of the bus: queue or turn away, nothing slow."""
        size = query.size
        stranger = not self._claims.knows(query.key.rpartition("/")[2])
        if size > MAX_ROLLOUT_BYTES:
            self._malformed(query, f"payload of {size} bytes; allowed up to {MAX_ROLLOUT_BYTES}")
            return
        with self._changed:
            full = (
                self._closed
                or len(self._waiting) >= (max(self._max_waiting // _STRANGERS, 1) if stranger else self._max_waiting)
                or self._waiting_bytes + size > self._max_waiting_bytes
                or self._waiting_of[query.key] >= _WAITING_PER_ACTOR
            )
            if not full:
                self._waiting.append(query)
                self._waiting_bytes += size
                self._waiting_of[query.key] += 1
                self._changed.notify()
        if full:
            self._answer(query, Ack("busy", retry_s=_RETRY_S, reason="the learner's queue is full"))

    def _run(self) -> None:
        while True:
            with self._changed:
                self._changed.wait_for(lambda: self._closed or self._waiting)
                if self._closed:
                    return
                query = self._waiting.popleft()
                self._waiting_bytes -= query.size
                self._waiting_of[query.key] -= 1
                if not self._waiting_of[query.key]:
                    del self._waiting_of[query.key]
            try:
                self._handle(query)
            except Exception as error:  # a full disk, say: nothing was acked, so the actor keeps the rollout
                if str(error) not in self._logged:  # it comes again with every retry
                    self._logged.add(str(error))
                    log.error("an upload could not be stored", exc_info=error)
                self.counts["failed"] += 1
                self._answer(query, Ack("busy", retry_s=_FAILED_RETRY_S, reason=f"the learner failed: {error}"[:500]))

    def _handle(self, query: Query) -> None:
        try:
            header = decode_header(UploadHeader, query.attachment)
            if query.key != keys.upload(header.run, header.actor):
                raise ValueError(f"header of {header.run}/{header.actor} on key {query.key}")
            rollout = None if header.hello else decode_rollout(query.payload)
            if rollout is not None and len(rollout) != header.count:
                raise ValueError(f"count: got {header.count} in the header, {len(rollout)} in the payload")
        except ValueError as error:
            self._malformed(query, str(error))
            return
        try:
            ack = self._judge(header, rollout)
        except ValueError as error:  # the sink says that this rollout can never be stored
            self._malformed(query, str(error))
            return
        self._answer(query, ack)

    def _judge(self, header: UploadHeader, rollout: Rollout | None) -> Ack:
        if header.run != self.run_id:
            return self._refusal(header, f"run: got {header.run}; the learner here is of run {self.run_id}")
        if rollout is None:
            if not self._claims.take(header.actor, header.incarnation):
                return self._refusal(
                    header,
                    f"actor id {header.actor} is in use by another live process of run {self.run_id}; "
                    "give every actor its own id",
                )
            return Ack("welcome", expected=self._sink.expected_seq(header.actor), epoch=self._epoch)
        if header.epoch != self._epoch or not self._claims.holds(header.actor, header.incarnation):
            return Ack("hello", epoch=self._epoch, reason="this learner does not know this process; say hello")
        return self._sink.store(header, rollout)

    def _refusal(self, header: UploadHeader, reason: str) -> Ack:
        self._note(f"{header.run}/{header.actor}", reason)
        return Ack("refused", reason=reason, epoch=self._epoch)

    def _malformed(self, query: Query, reason: str) -> None:
        self.counts["malformed"] += 1
        _, run, _, actor = query.key.split("/")
        self._note(f"{run}/{actor}", reason)
        self._answer(query, Ack("refused", reason=reason[:500], epoch=self._epoch))

    def _answer(self, query: Query, ack: Ack) -> None:
        self.counts[ack.status] += 1
        query.reply(encode_header(ack))

    def _note(self, sender: str, reason: str) -> None:
        """Count a refusal under its sender; log the first one of each of the first senders."""
        sender = printable(sender)[:MAX_TEXT]  # a key may hold anything
        with self._changed:
            known = sender in self._refused
            if not known and len(self._refused) >= _COUNTED_SENDERS:
                sender = "others"
            self._refused[sender] += 1
            senders = len(self._refused)
        if not known and senders <= _LOGGED_SENDERS:
            log.warning("refused an upload of %s: %s", sender, reason)
            if senders == _LOGGED_SENDERS:
                log.warning("further senders of refused uploads are counted, not logged")
