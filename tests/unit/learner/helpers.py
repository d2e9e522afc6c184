"""Small rollouts whose every number says where it belongs."""

from __future__ import annotations

from typing import Any

import numpy as np

from appl_dist.learner.replay import Replay
from appl_dist.spec import Rollout

OBS, SCAN, ACT = 5, 2, 3


def small_replay(
    folder: Any = None, capacity: int = 100, n_step: int = 1, gamma: float = 0.9, sync: bool = False
) -> Replay:
    return Replay(folder, capacity, n_step, gamma, observation_size=OBS, scan_size=SCAN, action_size=ACT, sync=sync)


def rollout(first: int, n: int, terminal: bool = True, rewards: Any = None) -> Rollout:
    """Transitions `first` ... `first + n - 1`: observation[2] is the step's number, reward its power of 2."""
    numbers = np.arange(first, first + n + 1, dtype=np.float32)
    observations = np.zeros((n + 1, OBS), np.float32)
    observations[:, 2] = numbers
    observations[:, :2] = np.sin(numbers)[:, None]
    actions = np.repeat(np.cos(numbers[:n])[:, None], ACT, 1).astype(np.float32)
    given = 2.0 ** np.arange(n) if rewards is None else rewards
    return Rollout(observations, actions, np.asarray(given, np.float32), terminal, {}, SCAN)
