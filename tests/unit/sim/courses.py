"""Small worlds for the simulator's tests."""

from __future__ import annotations

import numpy as np

from appl_dist.sim.worlds import World


def course(*cylinders: tuple[float, float, float]) -> World:
    """A world of the given x, y, radius, without a path."""
    none = np.empty((0, 2))
    return World(0, "course", np.array(cylinders).reshape(-1, 3), none, none, np.zeros(5), 0)


EMPTY = course()
