"""The bus inside one process: the whole graph without sockets, for debugging and tests.

`MemoryHub().connect()` gives a session with the same behaviour as `session.Session`; uploads, weights,
liveness and control run on it unchanged, byte for byte. Messages are delivered on the sender's thread.
"""

from __future__ import annotations

import itertools
import logging
import threading
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

from appl_dist.wire.bus import Handle, Message, Query

log = logging.getLogger(__name__)

_identities = itertools.count(1)


def _matches(pattern: str, key: str) -> bool:
    wanted, got = pattern.split("/"), key.split("/")
    return len(wanted) == len(got) and all(w == g or "*" in (w, g) for w, g in zip(wanted, got, strict=True))


class MemoryHub:
    """Where sessions of one process meet."""

    def __init__(self) -> None:
        self._lock = threading.RLock()
        self._declared: dict[str, list[_Declared]] = {"subscribe": [], "serve": [], "token": [], "watch": []}

    def connect(self) -> MemorySession:
        return MemorySession(self)

    def matching(self, kind: str, key: str) -> list[_Declared]:
        with self._lock:
            return [declared for declared in self._declared[kind] if _matches(declared.key, key)]

    def add(self, declared: _Declared) -> None:
        with self._lock:
            self._declared[declared.kind].append(declared)
        if declared.kind == "token":
            self._tell(declared.key, True)
        if declared.kind == "watch":
            for token in self.matching("token", declared.key):
                _call(declared.callback, token.key, True)

    def remove(self, declared: _Declared) -> None:
        with self._lock:
            if declared not in self._declared[declared.kind]:
                return
            self._declared[declared.kind].remove(declared)
        if declared.kind == "token":
            self._tell(declared.key, False)

    def _tell(self, token: str, present: bool) -> None:
        for watch in self.matching("watch", token):
            _call(watch.callback, token, present)


@dataclass(eq=False)
class _Declared:
    hub: MemoryHub
    kind: str
    key: str
    callback: Callable[..., None]

    def close(self) -> None:
        self.hub.remove(self)


class MemorySession:
    """A `bus.Bus` on a hub."""

    def __init__(self, hub: MemoryHub) -> None:
        self.identity = f"memory-{next(_identities)}"
        self._hub = hub
        self._closed = False
        self._own: list[_Declared] = []

    def put(self, key: str, payload: bytes, attachment: bytes = b"", block: bool = False) -> None:
        if not self._closed:
            for subscriber in self._hub.matching("subscribe", key):
                _call(subscriber.callback, _Message(key, bytes(payload), bytes(attachment)))

    def get(self, key: str, payload: bytes = b"", attachment: bytes = b"", timeout_s: float = 5.0) -> Message | None:
        servers = [] if self._closed else self._hub.matching("serve", key)
        if not servers:
            return None
        query = _Query(key, bytes(payload), bytes(attachment))
        for server in servers:
            _call(server.callback, query)
        query.answered.wait(timeout_s)
        return query.answer

    def subscribe(self, key: str, callback: Callable[[Message], None]) -> Handle:
        return self._declare("subscribe", key, callback)

    def serve(self, key: str, callback: Callable[[Query], None]) -> Handle:
        return self._declare("serve", key, callback)

    def announce(self, key: str) -> Handle:
        return self._declare("token", key, lambda: None)

    def watch(self, key: str, callback: Callable[[str, bool], None]) -> Handle:
        return self._declare("watch", key, callback)

    def close(self) -> None:
        self._closed = True
        for declared in self._own:
            declared.close()

    def __enter__(self) -> MemorySession:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _declare(self, kind: str, key: str, callback: Callable[..., None]) -> Handle:
        if self._closed:
            raise ValueError("session: closed")
        declared = _Declared(self._hub, kind, key, callback)
        self._own.append(declared)
        self._hub.add(declared)
        return declared


def _call(callback: Callable[..., None], *arguments: Any) -> None:
    try:
        callback(*arguments)
    except Exception:
        log.exception("callback of the wire failed")


@dataclass
class _Message:
    key: str
    payload: bytes
    attachment: bytes

    @property
    def size(self) -> int:
        return len(self.payload)


@dataclass
class _Query(_Message):
    answered: threading.Event = field(default_factory=threading.Event)
    answer: _Message | None = None

    def reply(self, payload: bytes, attachment: bytes = b"") -> None:
        if self.answer is None:
            self.answer = _Message(self.key, bytes(payload), bytes(attachment))
            self.answered.set()
