"""Asking the learner again: what keeps a subscriber up to date when a message was lost or the learner restarted."""

from __future__ import annotations

import threading
from collections.abc import Callable

from appl_dist.wire import key_expressions as keys
from appl_dist.wire.bus import Bus


class LearnerPoll:
    """Calls `ask` from a thread of its own: at once, whenever a learner of the run appears, and every `period_s`.

    Subscribe before making one: what is published between the two is then not missed.
    """

    def __init__(self, bus: Bus, run_id: str, period_s: float, ask: Callable[[], None]) -> None:
        self._period_s = period_s
        self._ask = ask
        self._learners: set[str] = set()
        self._lock = threading.Lock()
        self._ask_now = threading.Event()
        self._ask_now.set()
        self._closed = False
        self._watch = bus.watch(keys.alive(run_id, "learner", keys.ANY, keys.ANY), self._seen)
        self._thread = threading.Thread(target=self._run, name="learner-poll", daemon=True)
        self._thread.start()

    @property
    def learner_present(self) -> bool:
        with self._lock:
            return bool(self._learners)

    def close(self) -> None:
        self._watch.close()
        self._closed = True
        self._ask_now.set()
        self._thread.join(timeout=6.0)

    def _seen(self, key: str, present: bool) -> None:
        with self._lock:
            (self._learners.add if present else self._learners.discard)(key)
        if present:
            self._ask_now.set()

    def _run(self) -> None:
        while not self._closed:
            self._ask_now.wait(self._period_s)
            self._ask_now.clear()
            if not self._closed:
                self._ask()
