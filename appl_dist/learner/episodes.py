"""Running figures of the episodes that arrive: success, traversal time, return, staleness, per world."""

from __future__ import annotations

import threading
from collections import deque
from typing import Any

import numpy as np

from appl_dist.spec import Rollout
from appl_dist.wire.run_status import EpisodeInfo
from appl_dist.wire.typed import decode

WINDOW = 200  # episodes
STALE_VERSIONS = 60  # about a minute, at one policy a second


MAX_WORLDS = 100_000


class EpisodeStatistics:
    """Means over the last WINDOW episodes. A failed trial counts `failed_time_s`, as in the papers' tables.

    `current`: (epoch, version) of the newest policy. A rollout is stale if its policy was more than STALE_VERSIONS
    behind when it arrived, or of an earlier learner process: what a spool holds when the learner comes back.
    Rollouts arrive on the wire's thread, figures are read by the learner's: both take the lock.
    """

    def __init__(self, failed_time_s: float) -> None:
        self._failed_time_s = failed_time_s
        self._recent: deque[tuple[bool, float, float, int]] = deque(maxlen=WINDOW)
        self._ages: deque[tuple[int, bool]] = deque(maxlen=WINDOW)  # transitions, stale
        self._worlds: dict[int, tuple[int, int, float]] = {}  # world: episodes, successes, sum of times
        self._lock = threading.Lock()
        self.episodes = 0
        self.current = (0, 0)

    def add(self, rollout: Rollout) -> None:
        """Count an arrived rollout; one that was cut short counts for staleness only.

        ValueError: its info lacks a field or holds a wrong value; nothing was counted.
        """
        known = EpisodeInfo.__dataclass_fields__
        episode = decode(EpisodeInfo, {name: value for name, value in rollout.info.items() if name in known})
        now_epoch, now_version = self.current
        behind = max(0, now_version - episode.policy_version)
        with self._lock:
            self._ages.append((len(rollout), behind > STALE_VERSIONS or episode.policy_epoch < now_epoch))
            if not episode.ended:
                return
            time_s = episode.time_s if episode.success else self._failed_time_s
            self.episodes += 1
            self._recent.append((episode.success, time_s, episode.return_, behind))
            if episode.world in self._worlds or len(self._worlds) < MAX_WORLDS:
                n, wins, total = self._worlds.get(episode.world, (0, 0, 0.0))
                self._worlds[episode.world] = (n + 1, wins + episode.success, total + time_s)

    def figures(self) -> dict[str, Any]:
        """episodes, success (share), time_s, return_, staleness (policy versions), stale_share (of transitions).

        None before any episode.
        """
        with self._lock:
            recent, ages = list(self._recent), list(self._ages)
            episodes = self.episodes
        share = sum(n for n, stale in ages if stale) / max(sum(n for n, _ in ages), 1)
        if not recent:
            none: dict[str, Any] = dict.fromkeys(("success", "time_s", "return_"))
            return {"episodes": 0, **none, "staleness": 0.0, "stale_share": share}
        success, time_s, return_, staleness = (float(np.mean(column)) for column in zip(*recent, strict=True))
        return {
            "episodes": episodes,
            "success": success,
            "time_s": time_s,
            "return_": return_,
            "staleness": staleness,
            "stale_share": share,
        }

    def worlds(self) -> dict[int, tuple[int, float, float]]:
        """Per world: episodes, success (share), mean time_s."""
        with self._lock:
            return {w: (n, wins / n, total / n) for w, (n, wins, total) in self._worlds.items()}
