"""The Navigator's own behaviour: maps, parameters, recoveries, bad input."""

import math
from dataclasses import replace

import numpy as np
import pytest

from appl_dist import _native
from appl_dist.planner.dwa import DWA
from appl_dist.planner.ideal_drive import cast_scan, drive
from appl_dist.planner.navigator import Navigator, State
from appl_dist.planner.planner_settings import PlannerSettings
from appl_dist.spec import LaserGeometry

NOTHING = np.full(720, np.inf, np.float32)
START = np.array([0.0, 0.0, 1.57])
REST = np.zeros(2)
GOAL = np.array([0.0, 10.0, 0.0])


def navigator(settings=PlannerSettings(), goal=GOAL):
    n = Navigator(settings)
    n.reset(goal)
    return n


def changed(**values):
    v = DWA.defaults
    for name, value in values.items():
        v[DWA.names.index(name)] = value
    return v


def wall(distance):
    """A scan of a wall straight ahead, `distance` m from the laser, 40 degrees wide."""
    scan = NOTHING.copy()
    angles = np.linspace(-2.35619, 2.35619, 720)
    near = np.abs(angles) < 0.35
    scan[near] = distance / np.cos(angles[near])
    return scan


def test_open_space_drives_straight_at_the_window_s_top():
    n = navigator()
    command = n.cycle(NOTHING, START, REST, 0.0)
    assert n.state == State.CONTROLLING
    assert command[0] == 0.5
    assert n.rollouts == 6 * 20 + 20
    assert len(n.path) > 300
    assert n.path[-1].tolist() == [0.0, 10.0]
    assert n.trajectory.shape == (n.trajectory.shape[0], 3)


def test_same_input_same_commands():
    runs = []
    cylinders = np.array([[0.1, 1.5, 0.075], [-0.6, 2.2, 0.075], [0.7, 3.0, 0.075]])
    for _ in range(2):
        n, pose, twist, commands = navigator(), START, REST, []
        for k in range(80):
            command = n.cycle(cast_scan(cylinders, pose, LaserGeometry()), pose, twist, 0.05 * k)
            pose, twist = drive(pose, twist, command, 5)
            commands.append(command.tolist())
        runs.append(commands)
    assert runs[0] == runs[1]


def test_a_hit_marks_inflates_and_is_cleared_by_seeing_through_it():
    n = navigator()
    n.add_scan(wall(1.0), START)
    n.update_local_map(START)
    lethal = n.local_costmap == 254
    assert lethal.sum() > 5
    assert (n.local_costmap == 253).sum() > lethal.sum()
    n.add_scan(wall(2.0), START)
    n.update_local_map(START)
    rows = np.flatnonzero((n.local_costmap == 254).any(axis=1)) * 0.05 + n.local_origin[1]
    assert rows.min() > 1.9  # the wall at 1.055 m is gone, the one at 2.055 m is there


def test_far_hits_clear_but_do_not_mark_and_no_return_does_nothing():
    n = navigator()
    n.add_scan(wall(2.6), START)
    n.update_local_map(START)
    assert not n.local_costmap.any()
    n.add_scan(wall(1.0), START)
    n.update_local_map(START)
    n.add_scan(NOTHING, START)
    n.update_local_map(START)
    assert (n.local_costmap == 254).any()


def test_the_local_map_follows_in_whole_cells_and_keeps_what_it_saw():
    n = navigator()
    n.add_scan(wall(1.0), START)
    n.update_local_map(START)
    before = {tuple(c) for c in np.argwhere(n.local_costmap == 254)}
    origin = n.local_origin
    n.add_scan(NOTHING, START)
    n.update_local_map(START + np.array([0.5, -0.3, 0.0]))
    moved = np.rint((n.local_origin - origin) / 0.05).astype(int)
    after = {(y + moved[1], x + moved[0]) for y, x in np.argwhere(n.local_costmap == 254)}
    assert moved.tolist() in ([10, -6], [9, -6], [10, -5], [9, -5])
    assert after == before


def test_a_new_inflation_radius_reaches_the_whole_of_both_maps():
    n = navigator()
    n.add_scan(wall(1.0), START)
    for update in (n.update_local_map, n.update_global_map):
        update(START)
    narrow = [(m > 0).sum() for m in (n.local_costmap, n.global_costmap)]
    n.set_parameters(changed(inflation_radius=0.5))
    n.add_scan(NOTHING, START)
    far = START + np.array([3.0, -3.0, 0.0])  # away from the wall
    for update in (n.update_local_map, n.update_global_map):
        update(far)
    assert all((m > 0).sum() > k for m, k in zip((n.local_costmap, n.global_costmap), narrow, strict=True))


def test_parameters_change_between_cycles():
    n = navigator()
    n.cycle(NOTHING, START, REST, 0.0)
    n.set_parameters(changed(vx_samples=12.9, vtheta_samples=8.2, max_vel_x=2.0))
    command = n.cycle(NOTHING, START, np.array([1.0, 0.0]), 0.05)
    assert n.rollouts == 12 * 8 + 8  # whole numbers, rounded down as dynamic_reconfigure does
    assert command[0] > 1.0


@pytest.mark.parametrize("name", DWA.names)
@pytest.mark.parametrize("value", [math.nan, math.inf, -1.0, 1e9])
def test_absurd_parameters_are_refused_by_name(name, value):
    n = navigator()
    with pytest.raises(ValueError, match=name):
        n.set_parameters(changed(**{name: value}))
    n.cycle(NOTHING, START, REST, 0.0)
    assert n.rollouts == 140  # the old ones are still in force


@pytest.mark.parametrize("name", sorted(_native.PLANNER_SETTINGS))
def test_settings_that_are_not_numbers_are_refused_by_name(name):
    with pytest.raises(ValueError, match=name):
        Navigator(replace(PlannerSettings(), **{name: math.nan}))


@pytest.mark.parametrize("counts", [(1, 1), (1, 20), (6, 1), (300, 300)])
def test_extreme_sample_counts_are_defined(counts):
    n = navigator()
    n.set_parameters(changed(vx_samples=counts[0], vtheta_samples=counts[1]))
    command = n.cycle(wall(1.5), START, REST, 0.0)
    assert np.isfinite(command).all()
    assert n.rollouts >= counts[0] * counts[1]


def test_bad_scans_and_poses_neither_crash_nor_reach_the_map():
    n = navigator()
    scan = NOTHING.copy()
    scan[::3] = np.nan
    scan[1::3] = -5.0
    scan[2::3] = 0.0
    assert np.isfinite(n.cycle(scan, START, REST, 0.0)).all()
    assert not n.local_costmap.any()
    for pose in (np.array([500.0, -500.0, 0.3]), np.array([19.99, 0.0, 1.0]), np.array([1e12, 0.0, 0.0])):
        assert np.isfinite(n.cycle(wall(1.0), pose, REST, 0.1)).all()
    for pose in (np.array([np.nan, 0.0, 0.0]), np.array([0.0, np.inf, 0.0])):
        with pytest.raises(ValueError, match="pose"):
            n.cycle(NOTHING, pose, REST, 0.2)
    with pytest.raises(ValueError, match="ranges"):
        n.add_scan(np.zeros(10, np.float32), START)
    with pytest.raises(ValueError, match="twist"):
        n.control(START, np.array([np.nan, 0.0]), 0.2)


def test_boxed_in_it_backs_up_whatever_stands_there():
    """No legal sample: -0.5 m/s and escape mode."""
    n = navigator()
    scan = np.full(720, 0.30, np.float32)
    command = n.cycle(scan, START, REST, 0.0)
    assert command.tolist() == [-0.5, 0.0]
    assert n.debug["escaping"]


def test_without_a_plan_it_clears_turns_and_gives_up():
    """Goal off the map: patience, clearing, turn, clearing, turn, abort; then zero until the next goal."""
    n = navigator(goal=np.array([0.0, 50.0, 0.0]))
    pose, twist, turned, clock = START, REST, 0.0, 0.0
    states = set()
    for k in range(2000):
        clock = 0.05 * k
        command = n.cycle(NOTHING, pose, twist, clock)
        states.add(n.state)
        turned += abs(command[1]) * 0.05
        pose, twist = drive(pose, twist, command, 5)
        if n.state == State.ABORTED:
            break
    assert n.state == State.ABORTED
    assert states == {State.PLANNING, State.CLEARING, State.ABORTED}
    assert n.recoveries == 4
    assert turned == pytest.approx(4 * math.pi, abs=0.8)  # two full turns
    assert 25.0 < clock < 40.0  # five times five seconds of patience and two turns
    assert n.cycle(NOTHING, pose, twist, clock + 1).tolist() == [0.0, 0.0]
    n.reset(GOAL)
    assert n.cycle(NOTHING, pose, REST, clock + 2)[0] > 0


def test_at_the_goal_it_turns_and_stops():
    n = navigator(goal=np.array([0.0, 1.5, 0.0]))
    pose, twist = START, REST
    for k in range(300):
        command = n.cycle(NOTHING, pose, twist, 0.05 * k)
        pose, twist = drive(pose, twist, command, 5)
        if n.goal_reached:
            break
    assert n.goal_reached
    assert command.tolist() == [0.0, 0.0]
    assert math.hypot(pose[0], pose[1] - 1.5) <= 0.25
    assert abs(pose[2]) < 0.157 + 0.06
    assert n.control(pose, REST, 20.0).tolist() == [0.0, 0.0]
    assert n.state == State.SUCCEEDED  # no plan came in between


def test_bearing_of_the_local_goal():
    n = navigator()
    assert n.local_goal_bearing(START) == 0.0
    n.cycle(NOTHING, START, REST, 0.0)
    assert n.local_goal_bearing(START) == pytest.approx(math.pi / 2 - 1.57, abs=0.06)
    assert n.local_goal_bearing(np.array([0.0, 0.0, 0.0])) == pytest.approx(math.pi / 2, abs=0.06)
    assert n.local_goal_bearing(np.array([0.0, 0.0, -3.0])) == pytest.approx(math.pi / 2 + 3.0 - 2 * math.pi, abs=0.06)
    # Past the plan's end: its last point.
    assert n.local_goal_bearing(np.array([0.0, 12.0, 0.0])) == pytest.approx(-math.pi / 2, abs=1e-6)


def test_an_unchanged_map_and_cell_reuse_the_plan():
    n = navigator()
    n.cycle(wall(2.0), START, REST, 0.0)
    first, cells = n.path, n.navfn_cells
    n.cycle(wall(2.0), START, REST, 0.05)
    assert n.path.tolist() == first.tolist()
    assert n.navfn_cells == cells > 0
    n.add_scan(wall(1.2), START)
    n.update_global_map(START)
    assert n.plan(START, 0.1)
    assert n.path.tolist() != first.tolist()
