"""One transition in replay's files and one batch out of them: the row layout, and packing to and from it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from appl_dist.learner.sum_tree import Rows
from appl_dist.spec import FloatArray, Rollout

MAX_ROLLOUT = (1 << 16) - 1  # `left` is uint16


@dataclass(frozen=True)
class Batch:
    """b transitions ready for a TD update; everything float32.

    observations, next_observations (b, obs); actions (b, act); returns (b,) the n-step reward sum
    sum_i gamma^i r_i; discounts (b,) what multiplies the value of next_observations: gamma^k for the k <= n
    steps summed, 0 where the episode ended for good. From a prioritised replay also rows (b,) int64, to be given back
    with their TD errors, and weights (b,) of each error in the critics' loss.
    """

    observations: FloatArray
    actions: FloatArray
    returns: FloatArray
    discounts: FloatArray
    next_observations: FloatArray
    rows: Rows | None = None
    weights: FloatArray | None = None


class RowLayout:
    """Rows of one shape. The first `scan_size` observation entries are fixed point of [-1, 1] in `scan_dtype`."""

    def __init__(self, observation_size: int, scan_size: int, action_size: int, scan_dtype: str) -> None:
        if scan_dtype not in ("uint8", "uint16"):
            raise ValueError(f"scan_dtype: got {scan_dtype!r}; allowed uint8, uint16")
        self.observation_size, self.scan_size, self.action_size = observation_size, scan_size, action_size
        self.scan_dtype = np.dtype(scan_dtype)
        self._levels = float(np.iinfo(self.scan_dtype).max)
        self.dtype = np.dtype(
            [
                ("scan", scan_dtype, (scan_size,)),
                ("other", "<f4", (observation_size - scan_size,)),
                ("action", "<f4", (action_size,)),
                ("reward", "<f4"),
                ("left", "<u2"),  # transitions from here to the rollout's end; 0: its last observation, or a gap
                ("terminal", "u1"),  # the rollout's, on every row
            ],
            align=True,
        )

    @property
    def scan_error(self) -> float:
        """Largest error of a stored scan entry, in observation units (1 unit = 1 m of range)."""
        return 1.0 / self._levels

    def pack(self, rollout: Rollout, most: int) -> NDArray[Any]:
        """(n + 1,) rows of a rollout of at most `most` transitions; ValueError names what does not fit the layout."""
        n = len(rollout)
        if not 1 <= n <= min(MAX_ROLLOUT, most):
            raise ValueError(f"rollout: got {n} transitions; allowed 1..{min(MAX_ROLLOUT, most)}")
        for name, shape in (
            ("observations", (n + 1, self.observation_size)),
            ("actions", (n, self.action_size)),
            ("rewards", (n,)),
        ):
            array = getattr(rollout, name)
            if array.shape != shape:
                raise ValueError(f"{name}: got shape {array.shape}; expected {shape}")
            if not np.isfinite(array).all():
                raise ValueError(f"{name}: holds a value that is not finite")
        scan = rollout.observations[:, : self.scan_size]
        for name, array in (("scan", scan), ("actions", rollout.actions)):
            worst = float(np.abs(array).max(initial=0.0))
            if worst > 1.0:
                raise ValueError(f"{name}: got {worst:g}; allowed -1..1 (store what was executed, clipped)")
        rows = np.zeros(n + 1, self.dtype)
        # Adding a half and truncating rounds to nearest; the product is never negative.
        rows["scan"] = (scan * (self._levels / 2) + (self._levels / 2 + 0.5)).astype(self.scan_dtype)
        rows["other"] = rollout.observations[:, self.scan_size :]
        rows["action"][:n] = rollout.actions
        rows["reward"][:n] = rollout.rewards
        rows["left"] = np.arange(n, -1, -1)
        rows["terminal"] = rollout.terminal
        return rows

    def unpack(self, rows: NDArray[Any]) -> FloatArray:
        """(n, observation) float32 of rows (n,)."""
        observations: FloatArray = np.empty((len(rows), self.observation_size), np.float32)
        scan = observations[:, : self.scan_size]
        np.multiply(rows["scan"], np.float32(2.0 / self._levels), out=scan, dtype=np.float32)
        scan -= 1.0
        observations[:, self.scan_size :] = rows["other"]
        return observations
