"""Prioritised experience replay (Schaul et al., ICLR 2016, proportional variant), over the rows of a replay ring.

Comes in: which rows hold new or no transitions, and TD errors of those sampled. Goes out: rows drawn with probability
P = p_i / sum p, p = (|error| + epsilon)^alpha, and weights (N P)^-beta that undo the bias, scaled to at most 1. The
sums are a binary tree in one array, so that 5 million rows are changed and drawn in some twenty vectorised steps.
Priorities live in memory: a replay that is opened again starts with equal ones.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from appl_dist.spec import FloatArray

EPSILON = 1e-3  # of the error: a transition that fits perfectly is still seen now and then
BETA = 0.5

Rows = NDArray[np.int64]


class Priorities:
    """Priorities of `rows` ring rows, all 0: nothing can be drawn. `alpha` in (0, 1]: how strongly errors count."""

    def __init__(self, rows: int, alpha: float) -> None:
        self.alpha = alpha
        self._leaves = 1 << (rows - 1).bit_length()
        self._tree = np.zeros(2 * self._leaves)  # node i sums 2 i and 2 i + 1; untouched pages cost no memory
        self._largest = 1.0

    def enter(self, first: int, count: int) -> None:
        """`count` new transitions from row `first` on: as likely as the likeliest, so that each is seen soon."""
        self._fill(first, count, self._largest)

    def leave(self, first: int, count: int) -> None:
        """These rows hold no transition any more."""
        self._fill(first, count, 0.0)

    def update(self, rows: Rows, errors: FloatArray) -> None:
        """Take the TD errors (b,) of sampled rows; rows that have left meanwhile stay out."""
        kept = self._tree[self._leaves + rows] > 0.0
        values = (np.abs(errors[kept].astype(np.float64)) + EPSILON) ** self.alpha
        self._largest = max(self._largest, float(values.max(initial=0.0)))
        self._set(rows[kept], values)

    def draw(self, count: int, stored: int, rng: np.random.Generator) -> tuple[Rows, FloatArray]:
        """`count` rows, one from each equal stretch of the total, and their weights (count,); `stored` is N."""
        total = self._tree[1]
        at = (np.arange(count) + rng.random(count)) * (total / count)
        node = np.ones(count, np.int64)
        while node[0] < self._leaves:
            node *= 2
            left = self._tree[node]
            # An empty right half is never entered, whatever rounding makes of `at`.
            right = (at >= left) & (self._tree[node + 1] > 0.0)
            at -= np.where(right, left, 0.0)
            node += right
        weights = (stored * self._tree[node] / total) ** -BETA
        return node - self._leaves, (weights / weights.max()).astype(np.float32)

    def _set(self, rows: Rows, values: NDArray[np.float64]) -> None:
        node = rows + self._leaves
        self._tree[node] = values
        for _ in range(self._leaves.bit_length() - 1):
            node //= 2  # rows that meet are summed once each, to the same
            self._tree[node] = self._tree[2 * node] + self._tree[2 * node + 1]

    def _fill(self, first: int, count: int, value: float) -> None:
        low, high = first + self._leaves, first + count - 1 + self._leaves
        self._tree[low : high + 1] = value
        while low > 1:
            low, high = low // 2, high // 2
            below = self._tree[2 * low : 2 * high + 2]
            np.add(below[::2], below[1::2], out=self._tree[low : high + 1])
