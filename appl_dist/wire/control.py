"""What runs, with which config, and whether actors should go on.

The learner serves the run id, the frozen config, the desired state and its own numbers; an actor needs only
the endpoint and an id. State is a versioned value, not an event: it is sent on change, asked for when the
learner appears and every few seconds, and the larger version holds.
"""

from __future__ import annotations

import json
import logging
import threading
import time
from collections import Counter
from collections.abc import Callable
from typing import Any

from appl_dist.errors import PassingFault, UserError
from appl_dist.spec import WIRE_VERSION
from appl_dist.wire import key_expressions as keys
from appl_dist.wire.bus import Bus, Message, Query
from appl_dist.wire.codec import MAX_HEADER_BYTES, StateHeader, decode_header, encode_header, pack, unpack_map
from appl_dist.wire.polling import LearnerPoll
from appl_dist.wire.run_status import RunStatus
from appl_dist.wire.typed import decode

log = logging.getLogger(__name__)

MAX_CONFIG_BYTES = 1 << 20
_MAX_DEPTH = 16  # of maps and lists in a configuration
MAX_STATUS_BYTES = 8 << 20  # as many actors as there may be, with names of any length


class ControlServer:
    """The learner's side. Starts in state "run".

    status: called for each question of a terminal view; plain msgpack values.
    """

    def __init__(
        self,
        bus: Bus,
        run_id: str,
        config_json: str,
        epoch: int = 0,
        status: Callable[[], dict[str, Any]] | None = None,
    ) -> None:
        self.run_id = keys.check_name("run_id", run_id)
        if len(config_json.encode()) > MAX_CONFIG_BYTES or _json_object(config_json) is None:
            raise ValueError(f"config_json: expected a JSON object of up to {MAX_CONFIG_BYTES} bytes")
        self._bus = bus
        self._lock = threading.Lock()
        self._header = StateHeader(run_id, epoch, 0, "run")
        self._status = status
        self._run_info = pack({"wire": WIRE_VERSION, "run": run_id, "config": config_json})
        self._handles = [
            bus.serve(keys.RUN, lambda query: query.reply(self._run_info)),
            bus.serve(keys.state(run_id), lambda query: query.reply(encode_header(self._header))),
            bus.serve(keys.status(run_id), self._serve_status),
            bus.announce(keys.alive(run_id, "learner", "learner", bus.identity)),
        ]

    @property
    def state(self) -> str:
        return self._header.state

    def set_state(self, state: str) -> None:
        """Tell every actor, now and later, to "run" or to "stop"."""
        with self._lock:
            old = self._header
            self._header = StateHeader(self.run_id, old.epoch, old.version + 1, state)
            self._bus.put(keys.state(self.run_id), encode_header(self._header), block=True)

    def _serve_status(self, query: Query) -> None:
        try:
            status = self._status() if self._status else {}
            answer = pack({"wire": WIRE_VERSION, "status": status})
        except Exception as error:  # a viewer's question must not disturb learning; it gets the reason
            log.debug("status", exc_info=True)
            answer = pack({"wire": WIRE_VERSION, "status": {"error": repr(error)[:500]}})
        query.reply(answer)

    def close(self) -> None:
        for handle in reversed(self._handles):
            handle.close()


class ControlClient:
    """The actor's side: the desired state as last known, "run" until told otherwise. `counts`: malformed."""

    def __init__(self, bus: Bus, run_id: str, poll_s: float = 5.0) -> None:
        self.run_id = keys.check_name("run_id", run_id)
        self.counts: Counter[str] = Counter()
        self._bus = bus
        self._changed = threading.Condition()
        self._version = (-1, -1)
        self._state = "run"
        self._closed = False
        self._subscription = bus.subscribe(keys.state(run_id), self._take)
        self._poll = LearnerPoll(bus, run_id, poll_s, self._ask)

    def state(self) -> str:
        """ "run" or "stop"."""
        with self._changed:
            return self._state

    def wait_stop(self, timeout_s: float) -> bool:
        """Whether the state is "stop" within `timeout_s`."""
        with self._changed:
            return self._changed.wait_for(lambda: self._state == "stop" or self._closed, timeout_s) and (
                self._state == "stop"
            )

    @property
    def learner_present(self) -> bool:
        return self._poll.learner_present

    def close(self) -> None:
        self._subscription.close()
        with self._changed:
            self._closed = True
            self._changed.notify_all()
        self._poll.close()

    def _ask(self) -> None:
        answer = self._bus.get(keys.state(self.run_id), timeout_s=5.0)
        if answer is not None:
            self._take(answer)

    def _take(self, message: Message) -> None:
        try:
            if message.size > MAX_HEADER_BYTES:
                raise ValueError(f"{message.size} bytes")
            header = decode_header(StateHeader, message.payload)
            if header.run != self.run_id:
                raise ValueError(f"run: got {header.run}; expected {self.run_id}")
        except ValueError as error:
            self.counts["malformed"] += 1
            if self.counts["malformed"] == 1:
                log.warning("ignoring a state that cannot be read: %s", error)
            return
        with self._changed:
            if (header.epoch, header.version) > self._version:
                self._version = (header.epoch, header.version)
                self._state = header.state
                self._changed.notify_all()


def fetch_run(bus: Bus, timeout_s: float = 10.0) -> tuple[str, dict[str, Any]]:
    """(run id, frozen config) of the learner at the other end.

    UserError: no answer within `timeout_s`, or a learner of another wire version.
    """
    values = _ask(bus, keys.RUN, MAX_CONFIG_BYTES + MAX_HEADER_BYTES, timeout_s)
    run_id, config = values.get("run"), _json_object(values.get("config"))
    if not isinstance(run_id, str) or not keys.is_name(run_id) or config is None:
        raise UserError(f"the learner describes its run as {run_id!r:.80}, which cannot be read")
    return run_id, config


def _json_object(text: object) -> dict[str, Any] | None:
    try:
        value = json.loads(text) if isinstance(text, str) else None
    except (ValueError, RecursionError):
        return None
    return value if isinstance(value, dict) and not _deeper_than(_MAX_DEPTH, value) else None


def _deeper_than(depth: int, value: object) -> bool:
    inside = value.values() if isinstance(value, dict) else value if isinstance(value, list) else ()
    return any(depth == 0 or _deeper_than(depth - 1, item) for item in inside)


def fetch_status(bus: Bus, run_id: str, timeout_s: float = 5.0) -> dict[str, Any]:
    """The learner's numbers, as given to `ControlServer`; UserError when it does not answer."""
    status = _ask(bus, keys.status(run_id), MAX_STATUS_BYTES, timeout_s).get("status")
    if not isinstance(status, dict):
        raise UserError("the learner's status cannot be read")
    return status


def fetch_run_status(bus: Bus, run_id: str, timeout_s: float = 5.0) -> RunStatus:
    """The status of a learner, checked; UserError when it does not answer or what it says cannot be."""
    status = fetch_status(bus, run_id, timeout_s)
    if set(status) == {"error"}:
        raise UserError(f"the learner could not answer: {status['error']!r:.500}")
    try:
        return decode(RunStatus, status)
    except ValueError as error:
        raise UserError(f"the learner's status cannot be read: {error}") from None


def _ask(bus: Bus, key: str, limit: int, timeout_s: float) -> dict[str, Any]:
    deadline = time.monotonic() + timeout_s
    while True:
        answer = bus.get(key, timeout_s=max(deadline - time.monotonic(), 0.05))
        if answer is not None:
            break
        if time.monotonic() >= deadline:
            raise PassingFault(
                f"no learner answered within {timeout_s:g} s; it is starting, gone, or does not let this process ask"
            )
        time.sleep(0.05)  # connected, but nobody serves the key yet
    try:
        if answer.size > limit:
            raise ValueError(f"{answer.size} bytes; allowed up to {limit}")
        values = unpack_map(answer.payload, limit)
    except ValueError as error:
        raise UserError(f"the learner's answer cannot be read: {error}") from error
    if values.get("wire") != WIRE_VERSION:
        raise UserError(
            f"wire version: the learner speaks {values.get('wire')!r:.40}, this side {WIRE_VERSION}; "
            "run the same appl-dist version everywhere"
        )
    return values
