"""The newest policy, from the learner to every actor.

The publisher sends each new policy once, from a thread of its own, and serves the newest to whoever asks. A
subscriber keeps the largest (epoch, version), whatever the order of arrival, and asks for anything newer when
the learner's token comes back and every few seconds, so a lost message delays a policy but never loses it.
"""

from __future__ import annotations

import logging
import threading
from collections import Counter
from collections.abc import Callable

from appl_dist.wire import key_expressions as keys
from appl_dist.wire.bus import Bus, Message, Query
from appl_dist.wire.codec import WeightsHeader, decode_header, encode_header
from appl_dist.wire.polling import LearnerPoll

log = logging.getLogger(__name__)

MAX_WEIGHTS_BYTES = 64 << 20

Weights = tuple[int, int, bytes]  # epoch, version, blob


class WeightsPublisher:
    """Sends and serves the newest policy of a run until closed."""

    def __init__(self, bus: Bus, run_id: str) -> None:
        self.run_id = keys.check_name("run_id", run_id)
        self.sent = 0
        self._bus = bus
        self._changed = threading.Condition()
        self._newest: Weights | None = None
        self._unsent = False
        self._closed = False
        self._queryable = bus.serve(keys.weights(run_id), self._serve)
        self._thread = threading.Thread(target=self._run, name="weights-publisher", daemon=True)
        self._thread.start()

    def publish(self, epoch: int, version: int, blob: bytes) -> None:
        """Make this the newest policy; returns at once. One not yet sent is superseded.

        ValueError: not newer than the last one, or too large.
        """
        if not 0 < len(blob) <= MAX_WEIGHTS_BYTES:
            raise ValueError(f"blob: got {len(blob)} bytes; allowed 1..{MAX_WEIGHTS_BYTES}")
        WeightsHeader(self.run_id, epoch, version, len(blob))  # checks the numbers
        with self._changed:
            if self._newest is not None and (epoch, version) <= self._newest[:2]:
                raise ValueError(f"(epoch, version): got {(epoch, version)} after {self._newest[:2]}")
            self._newest = (epoch, version, blob)
            self._unsent = True
            self._changed.notify_all()

    def close(self) -> None:
        self._queryable.close()
        with self._changed:
            self._closed = True
            self._changed.notify_all()
        self._thread.join(timeout=5.0)

    def _run(self) -> None:
        while True:
            with self._changed:
                self._changed.wait_for(lambda: self._closed or self._unsent)
                if self._closed:
                    return
                assert self._newest is not None
                epoch, version, blob = self._newest
                self._unsent = False
            header = WeightsHeader(self.run_id, epoch, version, len(blob))
            # Blocking: dropping under load would cost the actors a policy until they ask again.
            self._bus.put(keys.weights(self.run_id), blob, encode_header(header), block=True)
            self.sent += 1

    def _serve(self, query: Query) -> None:
        """Answer with the newest policy, without its blob when the asker's is as new."""
        have = (0, 0, 0)
        try:
            asked = decode_header(WeightsHeader, query.attachment)
            have = (asked.epoch, asked.version, asked.size)
        except ValueError as error:
            log.debug("a question for weights without a readable header: %s", error)
        with self._changed:
            newest = self._newest
        if newest is None:
            query.reply(b"", encode_header(WeightsHeader(self.run_id, 0, 0, 0)))
            return
        epoch, version, blob = newest
        known = have[2] > 0 and have[:2] >= (epoch, version)
        size = 0 if known else len(blob)
        query.reply(b"" if known else blob, encode_header(WeightsHeader(self.run_id, epoch, version, size)))


class WeightsSubscriber:
    """Holds the newest policy of a run. `counts`: received, fetched, old, malformed.

    poll_s: how often to ask for anything newer, s.
    check: raises ValueError for a blob that is no policy; such a blob is counted and ignored.
    """

    def __init__(
        self, bus: Bus, run_id: str, poll_s: float = 10.0, check: Callable[[bytes], object] | None = None
    ) -> None:
        self.run_id = keys.check_name("run_id", run_id)
        self.counts: Counter[str] = Counter()
        self._bus = bus
        self._check = check
        self._changed = threading.Condition()
        self._newest: Weights | None = None
        self._closed = False
        self._subscription = bus.subscribe(keys.weights(run_id), lambda message: self._take(message, "received"))
        self._poll = LearnerPoll(bus, run_id, poll_s, self._ask)

    def latest(self) -> Weights | None:
        """(epoch, version, blob) of the newest policy seen, None before the first."""
        with self._changed:
            return self._newest

    def wait(self, newer_than: tuple[int, int] = (-1, -1), timeout_s: float = 10.0) -> Weights | None:
        """The newest policy once it is newer than `newer_than` (epoch, version); None after `timeout_s`."""
        with self._changed:
            self._changed.wait_for(
                lambda: self._closed or (self._newest is not None and self._newest[:2] > newer_than),
                timeout_s,
            )
            newest = self._newest
        return newest if newest is not None and newest[:2] > newer_than else None

    def close(self) -> None:
        self._subscription.close()
        with self._changed:
            self._closed = True
            self._changed.notify_all()
        self._poll.close()

    def _ask(self) -> None:
        newest = self.latest()
        epoch, version, size = (0, 0, 0) if newest is None else (*newest[:2], len(newest[2]))
        header = WeightsHeader(self.run_id, epoch, version, size)
        answer = self._bus.get(keys.weights(self.run_id), b"", encode_header(header), timeout_s=5.0)
        if answer is not None and answer.size:
            self._take(answer, "fetched")

    def _take(self, message: Message, how: str) -> None:
        try:
            header = decode_header(WeightsHeader, message.attachment)
            if header.run != self.run_id:
                raise ValueError(f"run: got {header.run}; expected {self.run_id}")
            if header.size != message.size or not 0 < header.size <= MAX_WEIGHTS_BYTES:
                raise ValueError(f"size: got {message.size} bytes, {header.size} in the header")
            version = (header.epoch, header.version)
            newest = self.latest()
            if newest is not None and version <= newest[:2]:
                self.counts["old"] += 1
                return
            blob = message.payload
            if self._check is not None:
                self._check(blob)
        except ValueError as error:
            self.counts["malformed"] += 1
            if self.counts["malformed"] == 1:
                log.warning("ignoring weights that cannot be read: %s", error)
            return
        self.counts[how] += 1
        with self._changed:  # two threads may bring policies; the larger one stays
            if self._newest is None or version > self._newest[:2]:
                self._newest = (*version, blob)
                self._changed.notify_all()
