"""The six primitives that everything on the wire is built from.

`session.Session` implements them over zenoh, `memory.MemorySession` inside one process; uploads, weights,
liveness and control are written once, against this interface. Callbacks run on threads of the bus: they
must return quickly; whatever they raise is logged and goes no further.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Protocol


class Message(Protocol):
    """Something received. `payload` is copied out on access, so check `size` (bytes) first."""

    @property
    def key(self) -> str: ...
    @property
    def size(self) -> int: ...
    @property
    def payload(self) -> bytes: ...
    @property
    def attachment(self) -> bytes: ...


class Query(Message, Protocol):
    """A message whose sender waits for an answer."""

    def reply(self, payload: bytes, attachment: bytes = b"") -> None:
        """Answer, once. Never raises; an answer to a sender that has gone is lost."""


class Handle(Protocol):
    """A declaration (subscription, queryable, token) that lasts until it is closed."""

    def close(self) -> None: ...


class Bus(Protocol):
    """One process's connection. Key expressions may hold `*` for one segment."""

    @property
    def identity(self) -> str:
        """Random name of this connection: the incarnation of the process that opened it."""

    def put(self, key: str, payload: bytes, attachment: bytes = b"", block: bool = False) -> None:
        """Send to all subscribers. Lost without an error while disconnected; `block` waits for slow ones."""

    def get(self, key: str, payload: bytes = b"", attachment: bytes = b"", timeout_s: float = 5.0) -> Message | None:
        """First answer, or None: nobody serves the key (at once) or no answer came within `timeout_s`."""

    def subscribe(self, key: str, callback: Callable[[Message], None]) -> Handle: ...

    def serve(self, key: str, callback: Callable[[Query], None]) -> Handle: ...

    def announce(self, key: str) -> Handle:
        """A token that stands while this process lives and is reachable."""

    def watch(self, key: str, callback: Callable[[str, bool], None]) -> Handle:
        """Call back (key, True) for every token there is or comes, (key, False) when one goes."""

    def close(self) -> None: ...
