"""How hard a BARN world is: the five measures of Perille et al. 2020, on the robot's configuration space.

Grids are (30, 30) bool, True = filled, indexed [row, column]; distances count cells.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Grid = NDArray[np.bool_]

GRID = 30
NAMES = ("closest obstacle", "visibility", "dispersion", "characteristic dimension", "tortuosity")
_AXES = np.array([(0, 1), (1, 1), (1, 0), (1, -1), (0, -1), (-1, -1), (-1, 0), (-1, 1)])
_DISPERSION_RADIUS = 3
# Sixteen directions in the published order, not quite that of the angle: the published numbers depend on it.
_CIRCLE = [
    (0, 1), (1, 2), (1, 1), (2, 1), (1, 0), (2, -1), (1, -1), (1, -2),
    (0, -1), (-2, -1), (-1, -1), (-1, -2), (-1, 0), (-2, 1), (-1, 1), (-1, 2),
]  # fmt: skip


def neighbours(grid: NDArray, outside: int) -> NDArray[np.int64]:
    """(..., R, C) sum of the eight neighbours; `outside` is above and below the map, 0 left and right of it."""
    padded = np.zeros((*grid.shape[:-2], grid.shape[-2] + 2, grid.shape[-1] + 2), np.int8)
    padded[..., 0, :] = padded[..., -1, :] = outside
    padded[..., 1:-1, 1:-1] = grid
    rows = padded[..., :-2, :] + padded[..., 1:-1, :] + padded[..., 2:, :]
    total: NDArray[np.int64] = rows[..., :-2] + rows[..., 1:-1] + rows[..., 2:] - padded[..., 1:-1, 1:-1]
    return total


def c_space(grid: Grid) -> Grid:
    """(..., R, C) cells where the robot's 5 x 5 cells (0.75 m) would touch a filled cell."""
    for axis in (-2, -1):
        line = np.moveaxis(grid, axis, 0)
        wide = line.copy()
        for k in (1, 2):
            wide[k:] |= line[:-k]
            wide[:-k] |= line[k:]
        grid = np.moveaxis(wide, 0, axis)
    return np.ascontiguousarray(grid)


def fill_interior(grid: Grid) -> Grid:
    """Fill the inside of solid blocks: world files have no cylinder where all eight neighbours are filled.

    The largest filling that the rule allows: a cell filled here has only filled neighbours, and a cell with a
    cylinder has an empty one. Cells on the rim always have their cylinder.
    """
    inner = np.zeros_like(grid)
    inner[1:-1, 1:-1] = True
    filled = grid | inner
    while True:
        full = inner & (neighbours(filled, 1) == 8)
        beside_impossible = neighbours(full & grid, 0) > 0
        keep = grid | (filled & full & ~beside_impossible)
        if (keep == filled).all():
            return keep
        # Only once the erosion has settled does a walled-in cylinder speak against its neighbours.
        eroded = grid | (filled & full)
        filled = keep if (eroded == filled).all() else eroded


def _free_steps(blocked: Grid, cells: NDArray[np.int64]) -> NDArray[np.int64]:
    """(m, 8) free steps from each cell along the eight directions, up to a blocked cell or the rim."""
    padded = np.ones((3 * GRID, 3 * GRID), np.bool_)
    padded[GRID:-GRID, GRID:-GRID] = blocked
    reach = np.arange(1, GRID + 1)
    at = GRID + cells[:, None, None, :] + reach[:, None] * _AXES[:, None, :]  # (m, 8, 30, 2)
    steps: NDArray[np.int64] = np.argmax(padded[at[..., 0], at[..., 1]], axis=2)
    return steps


def _dispersion(blocked: Grid, cells: NDArray[np.int64]) -> NDArray[np.float64]:
    pad = 2 * _DISPERSION_RADIUS
    padded = np.pad(blocked, pad)
    walls = np.zeros((len(cells), len(_CIRCLE)), np.bool_)
    for k, (dr, dc) in enumerate(_CIRCLE):
        cost = 2 if max(dr, dc) == 2 else 1  # as published: only knight moves of +2 count double
        for step in range(1, -(-_DISPERSION_RADIUS // cost) + 1):
            walls[:, k] |= padded[pad + cells[:, 0] + step * dr, pad + cells[:, 1] + step * dc]
    return (walls != np.roll(walls, 1, axis=1)).sum(axis=1).astype(np.float64)


def difficulty(grid: Grid, path: NDArray[np.int64]) -> NDArray[np.float64]:
    """(5,) measures, in the order of NAMES, of an occupancy grid along a path of (m, 2) row, column."""
    blocked = c_space(grid)
    obstacles = np.argwhere(blocked)
    distances = np.sqrt(((path[:, None] - obstacles[None]) ** 2).sum(axis=2))
    gaps = distances.min(axis=1, initial=(GRID - 1) // 2)  # as published, and what an empty field has
    steps = _free_steps(blocked, path)
    lengths = np.where(np.abs(_AXES).sum(axis=1) == 2, np.sqrt(2.0), 1.0)
    free = steps * lengths
    both = free[:, :4] + free[:, 4:]
    visible = (steps + 1) * lengths  # a ray counts the cell it starts from
    hops = np.sqrt((np.diff(path, axis=0) ** 2).sum(axis=1)).sum()
    chord = np.sqrt(((path[-1] - path[0]) ** 2).sum())
    dispersion = _dispersion(blocked, path).mean()
    return np.array([gaps.mean(), visible.mean(), dispersion, both.min(axis=1).mean(), hops / chord])
