"""Left and right are alike to a symmetric robot: a transition seen in a mirror could have happened too."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from appl_dist.learner.rows import Batch
from appl_dist.spec import BEARING, SCAN


def mirrored(batch: Batch, rng: np.random.Generator) -> Batch:
    """The batch with a random half of its transitions mirrored.

    Scans (row 0 the rightmost beam) are reversed, bearings of the local goal negated; the planner's parameters, in
    force and chosen, mean the same on both sides.
    """
    rows = rng.random(len(batch.returns)) < 0.5
    both = []
    for observations in (batch.observations, batch.next_observations):
        observations = observations.copy()
        observations[rows, SCAN] = observations[rows, SCAN][:, ::-1]
        observations[rows, BEARING] *= -1.0
        both.append(observations)
    return replace(batch, observations=both[0], next_observations=both[1])
