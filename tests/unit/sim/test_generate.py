"""The generator: the automaton's rules, BARN's own paths, and BARN's statistics."""

from __future__ import annotations

import numpy as np
import pytest

from appl_dist.sim.difficulty import GRID, c_space
from appl_dist.sim.generate import find_path, generate_world, generate_worlds, smooth, world_cylinders
from appl_dist.sim.worlds import field_grid, load_worlds, path_cells
from tests.shared_data import shared


def slow_smooth(grid: np.ndarray) -> np.ndarray:
    """One pass, cell by cell: rows beyond the map count as filled, columns beyond it as empty."""
    out = grid.copy()
    for r in range(GRID):
        for c in range(GRID):
            count = 0
            for i in (r - 1, r, r + 1):
                for j in (c - 1, c, c + 1):
                    if not 0 <= i < GRID:
                        count += 1
                    elif 0 <= j < GRID and (i, j) != (r, c):
                        count += int(grid[i, j])
            if count >= 5:
                out[r, c] = True
            elif count <= 1:
                out[r, c] = False
    return out


def test_the_automaton_follows_its_rules() -> None:
    grids = np.random.default_rng(1).random((3, GRID, GRID)) < 0.3
    expected = np.array([slow_smooth(slow_smooth(g)) for g in grids])
    np.testing.assert_array_equal(smooth(grids, 2), expected)


def test_each_world_stands_alone() -> None:
    together = generate_worlds(4, seed=3)
    for world in reversed(together):
        again = generate_world(world.index, seed=3)
        np.testing.assert_array_equal(again.cylinders, world.cylinders)
        np.testing.assert_array_equal(again.path, world.path)
    assert not np.array_equal(generate_world(0, seed=4).cylinders[:, :2], together[0].cylinders[:, :2])


def test_world_zero_is_pinned() -> None:
    """Runs name worlds by seed and index: a change here breaks every run that is to be repeated."""
    world = generate_world(0)
    assert (len(world.cylinders), len(world.path)) == (183, 31)
    assert world.cylinders[:, :2].sum() == pytest.approx(403.95)
    assert world.cylinders[:2].tolist() == [[-0.075, 0.075, 0.075], [-0.225, 0.075, 0.075]]


@pytest.mark.parametrize("index", [0, 100, 299])
def test_a_generated_world_can_be_crossed(index: int) -> None:
    world = generate_world(index)
    cells = path_cells(world.path)
    blocked = c_space(field_grid(world.cylinders))
    assert not blocked[cells[:, 0], cells[:, 1]].any()
    assert (cells[0, 1], cells[-1, 1]) == (0, GRID - 1)
    steps = np.diff(cells[1:], axis=0)
    assert np.abs(steps).max() == 1
    turns = np.abs(np.diff(np.unwrap(np.arctan2(steps[:, 0], steps[:, 1]))))
    assert turns.max() <= np.pi / 4 + 1e-9
    assert world.set_index == index // 25


def test_it_makes_barns_own_paths_and_cylinders() -> None:
    for world in load_worlds(shared("barn"))[::5]:
        grid, cells = field_grid(world.cylinders), path_cells(world.path)
        found = find_path(c_space(grid), tuple(cells[0]), tuple(cells[-1]))
        np.testing.assert_array_equal(found, cells)
        assert {tuple(c) for c in np.round(world_cylinders(grid), 6)} == {tuple(c) for c in world.cylinders}


def test_walled_in_goals_have_no_path() -> None:
    blocked = np.zeros((GRID, GRID), np.bool_)
    blocked[:, 15] = True
    assert find_path(blocked, (3, 0), (3, GRID - 1)) is None


def test_statistics_are_barns() -> None:
    """Two-sample Kolmogorov-Smirnov distance; 0.133 is its 1 % point for 300 worlds each."""
    from scipy.stats import ks_2samp

    real, made = load_worlds(shared("barn")), generate_worlds(300, seed=1)
    for k in range(5):
        assert ks_2samp([w.metrics[k] for w in real], [w.metrics[k] for w in made]).statistic < 0.133
    assert ks_2samp([w.density for w in real], [w.density for w in made]).statistic < 0.133
    assert len({w.set_index for w in made}) == 12


@pytest.mark.parametrize(
    "call", [lambda: generate_worlds(0), lambda: generate_world(-1), lambda: generate_world(0, -1)]
)
def test_counts_and_seeds_are_checked(call: object) -> None:
    with pytest.raises(ValueError, match="at least"):
        call()  # type: ignore[operator]
