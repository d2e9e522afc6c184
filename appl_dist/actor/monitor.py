"""What one trial leaves behind beside its outcome, sampled whenever the lidar fires."""

from __future__ import annotations

import math
from array import array
from hashlib import blake2b

import numpy as np
from numpy.typing import NDArray

from appl_dist.sim.simulator import Simulator

COLUMNS = ("t_s", "x_m", "y_m", "yaw_rad", "v_mps", "w_radps")
APART_MS = 500  # contacts closer together than this are one collision: a body that scrapes along bounces


class TrialMonitor:
    """Path, clearance and collisions of a trial.

    `trajectory` holds true poses in the world frame: its digest tells whether two trials drove the same, bit for bit.
    """

    def __init__(self) -> None:
        self.min_clearance_m = math.inf
        self._collisions = 0
        self._touched_ms = -APART_MS
        self._collided = False
        self._sampled_ms = -1
        self._samples = array("d")

    def sample(self, now_ms: int, simulator: Simulator) -> None:
        """Note where the robot is; a second call of one moment changes nothing."""
        if now_ms == self._sampled_ms:
            return
        self._sampled_ms = now_ms
        self._samples.extend((now_ms / 1000.0, *simulator.motion))
        clearance_m = simulator.clearance_m
        self.min_clearance_m = min(self.min_clearance_m, clearance_m)
        self._collided = simulator.collided
        if simulator.in_collision:
            self._collisions += now_ms - self._touched_ms >= APART_MS
            self._touched_ms = now_ms

    @property
    def collisions(self) -> int:
        """Times the robot ran into something; at least one if it ever touched, also between two samples."""
        return max(self._collisions, int(self._collided))

    @property
    def trajectory(self) -> NDArray[np.float64]:
        """(n, 6) samples in the order of COLUMNS. A copy."""
        return np.array(self._samples).reshape(-1, len(COLUMNS))

    def digest(self) -> str:
        """Sixteen hex digits that stand for every bit of the trajectory."""
        return blake2b(self._samples.tobytes(), digest_size=8).hexdigest()
