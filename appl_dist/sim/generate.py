"""Worlds by BARN's cellular automaton (Perille et al. 2020): the same statistics, as many as wanted, no files.

Each world is drawn from its own seed sequence (seed, index), so any of them can be made alone.
"""

from __future__ import annotations

import heapq
import math

import numpy as np
from numpy.typing import NDArray

from appl_dist._native import first_crossing
from appl_dist.sim.difficulty import GRID, Grid, c_space, neighbours
from appl_dist.sim.worlds import CELL_M, FIELD_ORIGIN, RADIUS_M, SETS, WORLDS_PER_SET, Floats, World, make_world

FILLS = (0.15, 0.20, 0.25, 0.30)  # chance of a cell to start filled
SMOOTHINGS = (2, 3, 4)  # passes of the automaton
BATCH = 64  # candidate grids drawn at once; of fill 0.30 one in 400 can be crossed
PENALTY = 5.0  # A*: a cell within PENALTY_CELLS of an obstacle costs PENALTY / distance more
PENALTY_CELLS = 2.0
# The eight moves in the order of their angle; a path turns by at most 45 degrees, one place to either side.
MOVES = ((-1, 1), (0, 1), (1, 1), (1, 0), (1, -1), (0, -1), (-1, -1), (-1, 0))

Cell = tuple[int, int]


def generate_worlds(count: int = SETS * WORLDS_PER_SET, seed: int = 0) -> list[World]:
    """The first `count` worlds of a seed, in BARN's order: 25 worlds of each fill and smoothing, then again."""
    if count < 1:
        raise ValueError(f"count: got {count}; at least 1")
    return [generate_world(index, seed) for index in range(count)]


def generate_world(index: int, seed: int = 0) -> World:
    """World `index` of a seed: fill and smoothing follow from the index as in BARN, 25 worlds a set, 12 sets."""
    if index < 0 or seed < 0:
        raise ValueError(f"index and seed: got {index} and {seed}; both must be at least 0")
    rng = np.random.default_rng(np.random.SeedSequence([seed, index]))
    fill, smoothing = divmod(index // WORLDS_PER_SET % SETS, len(SMOOTHINGS))
    region = np.empty((GRID, GRID), np.uint8)
    while True:
        grids = rng.random((BATCH, GRID, GRID)) < FILLS[fill]
        grids[:, [0, -1]] = True
        grids = smooth(grids, SMOOTHINGS[smoothing])
        blocked = c_space(grids)
        found = first_crossing(blocked.view(np.uint8), region)
        if found < 0:
            continue
        start, goal = (int(rng.choice(np.flatnonzero(region[:, column]))) for column in (0, -1))
        cells = find_path(blocked[found], (start, 0), (goal, GRID - 1))
        if cells is not None:
            name = f"generated_{seed}_{index}"
            return make_world(index, name, world_cylinders(grids[found]), cells, grids[found])


def smooth(grids: NDArray[np.bool_], passes: int) -> NDArray[np.bool_]:
    """The automaton on (..., 30, 30) grids: five filled neighbours of eight fill a cell, at most one empties it."""
    for _ in range(passes):
        count = neighbours(grids, 1)
        grids = (count >= 5) | (grids & (count >= 2))
    return grids


def world_cylinders(grid: Grid) -> Floats:
    """(n, 3) x, y, radius of a course: start box, then the filled cells of the field that are not interior."""
    inner = np.zeros_like(grid)
    inner[1:-1, 1:-1] = True
    cells = np.argwhere(grid & ~(inner & (neighbours(grid, 1) == 8)))
    x_low, y_back = FIELD_ORIGIN[0], 0.075
    back = np.array([(x_low + CELL_M * row, y_back) for row in range(GRID - 1, -1, -1)])
    side = [y_back + CELL_M * k for k in range(1, 34)]
    walls = np.array([(x, y) for y in side for x in (x_low, x_low + CELL_M * (GRID - 1))])
    centers = np.concatenate([back, walls, FIELD_ORIGIN + CELL_M * cells])
    return np.round(np.column_stack([centers, np.full(len(centers), RADIUS_M)]), 6)


def _penalties(blocked: Grid) -> list[list[float]]:
    """What A* adds for each cell, by its distance to the nearest blocked one."""
    penalty = np.zeros((GRID, GRID))
    padded = np.pad(blocked, 2)
    for dr, dc in sorted(((r, c) for r in range(-2, 3) for c in range(-2, 3)), key=lambda m: -math.hypot(*m)):
        distance = math.hypot(dr, dc)
        if 0.0 < distance <= PENALTY_CELLS:  # nearer obstacles are written later
            penalty[padded[2 + dr : 2 + dr + GRID, 2 + dc : 2 + dc + GRID]] = PENALTY / distance
    result: list[list[float]] = penalty.tolist()
    return result


def find_path(blocked: Grid, start: Cell, goal: Cell) -> NDArray[np.int64] | None:
    """The published A*, whose paths are not shortest.

    Its quirk is kept because it shapes the reference paths: a cell's priority is g + penalty when it is first
    reached and g + h + penalty only when it is reached again at less cost; g itself has no penalty.
    """
    walls = np.pad(blocked, 1, constant_values=True).tolist()
    penalty = _penalties(blocked)
    g: dict[Cell, float] = {start: 0.0}
    parent: dict[Cell, Cell] = {}
    order = {start: 0}  # of insertion: the first of equals is taken
    priority = {start: 0.0}
    queue = [(0.0, 0, start)]
    done: set[Cell] = set()
    while queue:
        f, _, cell = heapq.heappop(queue)
        if cell in done or f != priority[cell]:
            continue
        done.add(cell)
        if cell == goal:
            return _trace(parent, goal)
        r, c = cell
        for dr, dc in _moves(cell, parent):
            child = (r + dr, c + dc)
            if walls[r + dr + 1][c + dc + 1] or child in done:
                continue
            if dr and dc and walls[r + dr + 1][c + 1] and walls[r + 1][c + dc + 1]:
                continue
            cost = g[cell] + math.hypot(dr, dc)
            seen = child in g
            if seen and cost >= g[child]:
                continue
            h = math.hypot(child[0] - goal[0], child[1] - goal[1]) if seen else 0.0
            g[child], parent[child] = cost, cell
            priority[child] = cost + h + penalty[child[0]][child[1]]
            heapq.heappush(queue, (priority[child], order.setdefault(child, len(order)), child))
    return None


def _moves(cell: Cell, parent: dict[Cell, Cell]) -> tuple[Cell, ...]:
    if cell not in parent:
        return MOVES
    before = parent[cell]
    k = MOVES.index((cell[0] - before[0], cell[1] - before[1]))
    return MOVES[k - 1], MOVES[k], MOVES[(k + 1) % len(MOVES)]


def _trace(parent: dict[Cell, Cell], goal: Cell) -> NDArray[np.int64]:
    """From start to goal; the published paths name their start twice."""
    cells = [goal]
    while cells[-1] in parent:
        cells.append(parent[cells[-1]])
    return np.array([cells[-1], *cells[::-1]], np.int64)
