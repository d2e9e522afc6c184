"""Running figures of the episodes that arrive: success, traversal time, return, staleness, per world."""

from __future__ import annotations

import threading
from collections import deque
from typing import Any

import numpy as np

from appl_dist.spec import Rollout

WINDOW = 200  # episodes


class EpisodeStatistics:
    """Means over the last WINDOW episodes. A failed trial counts `failed_time_s`, as in the papers' tables.

    Rollouts arrive on the wire's thread, figures are read by the learner's: both take the lock.
    """

    def __init__(self, failed_time_s: float) -> None:
        self._failed_time_s = failed_time_s
        self._recent: deque[tuple[bool, float, float, int]] = deque(maxlen=WINDOW)
        self._worlds: dict[int, tuple[int, int, float]] = {}  # world: episodes, successes, sum of times
        self._lock = threading.Lock()
        self.episodes = 0
        self.current_version = 0

    def add(self, rollout: Rollout) -> None:
        """Take an arrived rollout; one that was cut short counts for staleness only."""
        info = rollout.info
        staleness = max(0, self.current_version - int(info.get("policy_version", 0)))
        if not info.get("ended", False):
            return
        success = bool(info["success"])
        time_s = float(info["time_s"]) if success else self._failed_time_s
        with self._lock:
            self.episodes += 1
            self._recent.append((success, time_s, float(info["return"]), staleness))
            n, wins, total = self._worlds.get(int(info["world"]), (0, 0, 0.0))
            self._worlds[int(info["world"])] = (n + 1, wins + success, total + time_s)

    def figures(self) -> dict[str, Any]:
        """episodes, success (share), time_s, return, staleness (policy versions); None before any episode."""
        with self._lock:
            recent = list(self._recent)
            episodes = self.episodes
        if not recent:
            return {"episodes": 0, "success": None, "time_s": None, "return": None, "staleness": 0.0}
        success, time_s, return_, staleness = (float(np.mean(column)) for column in zip(*recent, strict=True))
        return {
            "episodes": episodes,
            "success": success,
            "time_s": time_s,
            "return": return_,
            "staleness": staleness,
        }

    def worlds(self) -> dict[int, tuple[int, float, float]]:
        """Per world: episodes, success (share), mean time_s."""
        with self._lock:
            return {w: (n, wins / n, total / n) for w, (n, wins, total) in self._worlds.items()}
