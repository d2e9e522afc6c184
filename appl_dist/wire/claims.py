"""Which process uploads as which actor: one at a time.

A process claims an actor id with its hello and a liveliness token. Another process gets the id only once the
first one's token is gone: at once after a kill, after the lease when it froze or its network was cut.
"""

from __future__ import annotations

import threading
from collections.abc import Callable

from appl_dist.wire import key_expressions as keys
from appl_dist.wire.bus import Bus

FREE = float("-inf")  # last spoke: never, so that grace does not hold
MAX_OWNERS = 1 << 16


class Claims:
    """Owners of actor ids, the learner's side.

    grace_s: how long an owner whose token has not (yet) been seen keeps its id after it last spoke, s.
    clock: seconds, monotonic.
    """

    def __init__(self, bus: Bus, run_id: str, grace_s: float, clock: Callable[[], float]) -> None:
        self._grace_s = grace_s
        self._clock = clock
        self._lock = threading.Lock()
        self._owners: dict[str, tuple[str, float]] = {}  # actor → incarnation, when it last spoke
        self._tokens: set[tuple[str, str]] = set()
        self._watch = bus.watch(keys.claim(run_id, keys.ANY, keys.ANY), self._seen)

    def take(self, actor: str, incarnation: str) -> bool:
        """Make `incarnation` the owner of `actor`; False while another live process is, or MAX_OWNERS are."""
        with self._lock:
            owner, spoke_s = self._owners.get(actor, (incarnation, 0.0))
            if owner != incarnation and ((actor, owner) in self._tokens or self._clock() - spoke_s < self._grace_s):
                return False
            if actor not in self._owners and len(self._owners) >= MAX_OWNERS:
                self._forget_gone()
                if len(self._owners) >= MAX_OWNERS:
                    return False
            self._owners[actor] = (incarnation, self._clock())
            return True

    def knows(self, actor: str) -> bool:
        """Whether a process claimed `actor` and still stands, or did a moment ago."""
        with self._lock:
            owner, spoke_s = self._owners.get(actor, ("", FREE))
            return (actor, owner) in self._tokens or self._clock() - spoke_s < self._grace_s

    def holds(self, actor: str, incarnation: str) -> bool:
        """Whether `incarnation` owns `actor`; refreshes its claim if so.

        A claim that was set free stays free until its token returns: what speaks here may be the last words of a
        process that is gone, and must not keep its successor out.
        """
        with self._lock:
            owner, spoke_s = self._owners.get(actor, ("", 0.0))
            if owner != incarnation:
                return False
            if spoke_s != FREE or (actor, incarnation) in self._tokens:
                self._owners[actor] = (incarnation, self._clock())
            return True

    def _forget_gone(self) -> None:
        now_s = self._clock()
        self._owners = {
            actor: (owner, spoke_s)
            for actor, (owner, spoke_s) in self._owners.items()
            if (actor, owner) in self._tokens or now_s - spoke_s < self._grace_s
        }

    def _seen(self, key: str, present: bool) -> None:
        *_, actor, incarnation = key.split("/")
        with self._lock:
            if present:
                self._tokens.add((actor, incarnation))
                return
            self._tokens.discard((actor, incarnation))
            if self._owners.get(actor, ("", 0.0))[0] == incarnation:
                self._owners[actor] = (incarnation, FREE)  # free to take, still its own if it returns

    def close(self) -> None:
        self._watch.close()
