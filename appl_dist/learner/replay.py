"""Replay memory: rollouts in, n-step batches out.

A `Replay` samples; its `ring` (`rollout_ring.py`) takes rollouts in and holds each observation once. Its scans are
fixed point of [-1, 1] (uint8: error at most 1/255, 3.9 mm of range, which moves actions by less than the least
exploration noise: benchmarks/replay_sampling.py); the rest is float32. A row of the papers' sizes is 796 bytes, so 5
million transitions take 4.1 GB. Rows are memory-mapped (`folder`) or plain memory (`folder` None).
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Self

import numpy as np

from appl_dist.errors import UserError
from appl_dist.learner.rollout_ring import Ring, rows_for
from appl_dist.learner.row_layout import Batch, RowLayout
from appl_dist.learner.sum_tree import Priorities, Rows
from appl_dist.spec import FloatArray


class Replay:
    """Samples from a ring that holds at most `capacity` transitions (fewer if rollouts average under 16 each).

    ring: where rollouts go in, and what there is to say of them. One thread may insert while another samples.
    priority_exponent 0 samples uniformly, above it by TD error (`sum_tree.py`). sync: `insert` returns when the rollout
    is on the disk. UserError if `folder` holds a replay of another shape, is in use, or its disk is full.
    """

    def __init__(
        self,
        folder: str | Path | None,
        capacity: int,
        n_step: int,
        gamma: float,
        *,
        observation_size: int,
        scan_size: int,
        action_size: int,
        scan_dtype: str = "uint8",
        priority_exponent: float = 0.0,
        sync: bool = False,
    ) -> None:
        if capacity < 1:
            raise ValueError(f"capacity: got {capacity} transitions; at least 1")
        if n_step < 1:
            raise ValueError(f"n_step: got {n_step}; at least 1")
        if not 0.0 <= gamma <= 1.0:
            raise ValueError(f"gamma: got {gamma}; allowed 0..1")
        if not 0.0 <= priority_exponent <= 1.0:
            raise ValueError(f"priority_exponent: got {priority_exponent}; allowed 0..1")
        self.n_step, self.gamma = n_step, gamma
        layout = RowLayout(observation_size, scan_size, action_size, scan_dtype)
        self._priorities = Priorities(rows_for(capacity), priority_exponent) if priority_exponent else None
        self.ring = Ring(folder, capacity, layout, self._priorities, sync)

    @classmethod
    def reopen(cls, folder: str | Path) -> Replay:
        """The replay in `folder` with the sizes it was made with, to look at what it holds. UserError: none there."""
        try:
            meta = json.loads((Path(folder) / "meta.json").read_text("utf-8"))
            names = ("capacity", "observation_size", "scan_size", "action_size", "scan_dtype")
            sizes = {name: meta[name] for name in names}
        except (OSError, ValueError, TypeError, KeyError) as e:
            raise UserError(f"replay folder {folder}: meta.json cannot be read: {e}") from None
        return cls(folder, n_step=1, gamma=1.0, **sizes)

    def sample(self, batch: int, rng: np.random.Generator) -> Batch:
        """`batch` transitions drawn with replacement; IndexError if there are none."""
        if batch < 1:
            raise ValueError(f"batch: got {batch}; at least 1")
        steps = np.arange(self.n_step)
        with self.ring.reading() as data:
            if not len(self.ring):
                raise IndexError("replay is empty")
            weights = None
            if self._priorities is None:
                first = self.ring.draw(batch, rng)
            else:
                first, weights = self._priorities.draw(batch, len(self.ring), rng)
            now = data.take(first)
            left = now["left"].astype(np.int64)  # (b,)
            taken = np.minimum(left, self.n_step)  # (b,) k
            if self.n_step == 1:
                rewards = now["reward"][:, None]
            else:  # past the end: the last reward again, times 0 below
                rewards = data["reward"][first[:, None] + np.minimum(steps, taken[:, None] - 1)]
            then = data.take(first + taken)
        powers = np.where(steps < taken[:, None], self.gamma**steps, 0.0)  # (b, n)
        ended = (now["terminal"] != 0) & (taken == left)
        return Batch(
            observations=self.ring.layout.unpack(now),
            actions=np.ascontiguousarray(now["action"]),
            returns=(rewards * powers).sum(1).astype(np.float32),
            discounts=np.where(ended, 0.0, self.gamma**taken).astype(np.float32),
            next_observations=self.ring.layout.unpack(then),
            rows=None if weights is None else first,
            weights=weights,
        )

    def prioritise(self, rows: Rows, errors: FloatArray) -> None:
        """Take the TD errors (b,) of a sampled batch; without priorities there is nothing to do."""
        if self._priorities is not None:
            with self.ring.reading():
                self._priorities.update(rows, errors)

    def close(self) -> None:
        """Close the ring: nothing can be inserted or sampled after."""
        self.ring.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exc: object) -> None:
        self.close()
