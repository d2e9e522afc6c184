"""The simulator as its users see it: determinism, contacts, odometry, errors."""

from __future__ import annotations

import gzip
import json
import math
from itertools import pairwise

import numpy as np
import psutil
import pytest

from appl_dist._native import Robot
from appl_dist.sim.generate import generate_world, generate_worlds
from appl_dist.sim.robot import RobotSettings
from appl_dist.sim.robots import JACKAL
from appl_dist.sim.simulator import Simulator
from appl_dist.sim.worlds import World
from tests.shared_data import shared
from tests.unit.sim.courses import EMPTY, course

START = np.array([-2.0, 3.0, 1.57])


def record(simulator: Simulator, world: World, seed: int, steps: int = 400) -> bytes:
    """Everything an episode yields, as bytes; the commands drive into the obstacles of most worlds."""
    simulator.reset(world, seed, START)
    rng, out = np.random.default_rng(seed), []
    for k in range(steps):
        if k % 10 == 0:
            command = (rng.uniform(-0.5, 2.0), rng.uniform(-2.0, 2.0))
        simulator.step(command, 0.001 * rng.integers(1, 40))
        out += [simulator.pose, simulator.twist, simulator.odom_pose, simulator.odom_twist]
        out.append(np.array([simulator.time_s, simulator.collided, simulator.in_collision, simulator.tilt_rad]))
    out.append(simulator.scan())
    return b"".join(a.tobytes() for a in out)


def test_an_episode_does_not_depend_on_what_came_before() -> None:
    worlds = generate_worlds(3, seed=2)
    with Simulator() as fresh:
        first = record(fresh, worlds[1], 11)
        assert fresh.collided
    with Simulator() as used, Simulator() as other:
        record(used, worlds[0], 4, 60)
        record(other, worlds[2], 5, 60)
        used.step((1.0, 1.0), 0.013)  # leaves an unfinished step behind
        assert record(used, worlds[1], 11) == first
        assert record(used, worlds[1], 12) != first


def test_two_simulators_side_by_side_do_not_meet() -> None:
    world = generate_world(0)
    with Simulator() as alone:
        alone.reset(world, 0, START)
        for _ in range(100):
            alone.step((1.0, 0.3), 0.02)
        expected = alone.pose
    with Simulator() as a, Simulator() as b:
        a.reset(world, 0, START)
        b.reset(course((-2.0, 3.6, 0.075)), 0, START)
        for _ in range(100):
            a.step((1.0, 0.3), 0.02)
            b.step((1.0, 0.0), 0.02)
        np.testing.assert_array_equal(a.pose, expected)
        assert b.collided


def test_free_motion_is_the_tyre_model_alone() -> None:
    """pybullet is carried along and adds nothing, however the time is cut."""
    vehicle = Robot(JACKAL.vehicle(RobotSettings()))
    vehicle.reset(np.zeros(3), 3, np.empty((0, 3)))
    with Simulator() as simulator:
        simulator.reset(EMPTY, 3, np.zeros(3))
        for k, ms in enumerate([7, 20, 1, 33, 100, 4, 50] * 6):
            command = (1.0 + 0.5 * math.sin(k), math.cos(k))
            simulator.step(command, 0.001 * ms)
            vehicle.command(*command, 0)
            vehicle.drive(ms)
        assert tuple(simulator.pose) == vehicle.pose
        assert tuple(simulator.odom_pose) == vehicle.odom_pose
        assert simulator.distance_m == vehicle.distance
        assert not simulator.collided


@pytest.mark.parametrize("speed", [0.25, 0.5, 1.0, 2.0])
def test_head_on_it_stops_dead(speed: float) -> None:
    """Gazebo: stops at all speeds with its front at the cylinder (1.5 - .075 - .21 = 1.215), wheels spinning."""
    with Simulator() as simulator:
        simulator.reset(course((1.5, 0.0, 0.075)), 0, np.zeros(3))
        for _ in range(round((1.5 / speed + 0.5) / 0.05)):
            simulator.step((speed, 0.0), 0.05)
        assert simulator.pose == pytest.approx([1.215, 0.0, 0.0], abs=0.01)
        assert simulator.twist == pytest.approx([0.0, 0.0], abs=0.01)
        assert simulator.collided
        assert simulator.in_collision
        assert simulator.clearance_m == pytest.approx(0.0, abs=2e-3)
        assert simulator.odom_pose[0] > simulator.pose[0] + 0.1
        assert simulator.wheel_twist[0] == pytest.approx(speed)


def test_off_centre_it_is_turned_around_the_cylinder() -> None:
    """Gazebo at 1 m/s, 0.19 m to the side: turns to 1.57 rad, ends at (1.52, -0.10)."""
    with Simulator() as simulator:
        simulator.reset(course((1.5, 0.19, 0.075)), 0, np.zeros(3))
        for _ in range(100):
            simulator.step((1.0, 0.0), 0.05)
        assert simulator.pose == pytest.approx([1.52, -0.10, 1.57], abs=0.03)


@pytest.mark.parametrize("dt_s", [0.003, 0.02, 0.25])
@pytest.mark.parametrize("heading", [0.0, math.pi / 4])
def test_nothing_is_passed_through(dt_s: float, heading: float) -> None:
    """A row of touching cylinders, at full speed, in long and in odd steps."""
    wall = course(*((x, 2.0, 0.075) for x in np.arange(-2.0, 2.0, 0.15)))
    with Simulator() as simulator:
        simulator.reset(wall, 0, np.array([0.0, 0.0, math.pi / 2 + heading]))
        for _ in range(round(2.0 / dt_s)):
            simulator.step((2.0, 0.0), dt_s)
            assert simulator.clearance_m > -0.02
        assert simulator.collided
        assert simulator.pose[1] < 2.0 - 0.21 - 0.05


def test_collision_is_latched_and_contact_is_not() -> None:
    with Simulator() as simulator:
        simulator.reset(course((1.0, 0.0, 0.075)), 0, np.zeros(3))
        for _ in range(40):
            simulator.step((1.0, 0.0), 0.05)
        assert (simulator.collided, simulator.in_collision) == (True, True)
        for _ in range(20):
            simulator.step((-0.5, 0.0), 0.05)
        assert (simulator.collided, simulator.in_collision) == (True, False)
        simulator.reset(EMPTY, 0, np.zeros(3))
        assert (simulator.collided, simulator.in_collision) == (False, False)
        assert (simulator.time_s, simulator.distance_m) == (0.0, 0.0)


def test_passing_close_is_no_collision() -> None:
    """3 mm between wheel (0.2078 from the axis) and cylinder on both sides."""
    gap = 0.2078 + 0.003 + 0.075
    with Simulator() as simulator:
        simulator.reset(course((1.0, gap + 0.0005, 0.075), (1.0, -gap, 0.075)), 0, np.zeros(3))
        nearest = 1.0
        for _ in range(100):
            simulator.step((0.5, 0.0), 0.05)
            nearest = min(nearest, simulator.clearance_m)
        assert simulator.pose[0] > 2.0
        assert not simulator.collided
        assert 0.001 < nearest < 0.004


def test_clearance_is_the_distance_to_the_hull() -> None:
    with Simulator() as simulator:
        for cylinder, expected in (
            ((0.4, 0.0, 0.1), 0.4 - 0.1 - 0.21),  # the chassis' front
            ((0.0, -1.0, 0.1), math.hypot(0.033, 1.0 - 0.207795) - 0.1),  # between the wheels
            ((0.131, 1.0, 0.1), 1.0 - 0.1 - 0.207795),  # a wheel's side
            ((0.5, 0.5, 0.1), math.hypot(0.5 - 0.229, 0.5 - 0.207795) - 0.1),  # a wheel's corner
        ):
            simulator.reset(course(cylinder, (40.0, 40.0, 1.0)), 0, np.zeros(3))
            assert simulator.clearance_m == pytest.approx(expected, abs=1e-9)
        simulator.reset(EMPTY, 0, np.zeros(3))
        assert simulator.clearance_m == 100.0


def test_odometry_twist_follows_with_its_lag_and_noise() -> None:
    with Simulator() as simulator:
        simulator.reset(EMPTY, 1, np.zeros(3))
        simulator.step((1.0, 0.0), 0.02)
        assert simulator.odom_twist[0] == pytest.approx(0.5 * 0.4)  # half of what the wheels do after 20 ms
        rates = []
        for _ in range(2000):
            simulator.step((0.0, 0.0), 0.02)
            rates.append(simulator.odom_twist[1])
        late = np.array(rates[100:])
        assert late.std() == pytest.approx(0.005 * 0.95 / math.sqrt(1 - 0.05**2), rel=0.1)
        assert abs(late.mean()) < 5e-4


def test_the_last_command_times_out() -> None:
    with Simulator() as simulator:
        simulator.reset(EMPTY, 0, np.zeros(3))
        simulator.step((0.5, 0.0), 0.2)
        simulator.step((0.5, 0.0), 0.2, command_age_s=0.2)
        assert simulator.twist[0] == pytest.approx(0.0, abs=1e-6)
        simulator.step((0.5, 0.0), 0.2)
        assert simulator.twist[0] == pytest.approx(0.5, abs=0.01)


def test_the_ideal_drive_is_that_of_the_recorded_loops() -> None:
    with gzip.open(shared("reference", "sim.jsonl.gz"), "rt") as lines:
        episodes = [json.loads(line) for line, _ in zip(lines, range(4), strict=False)]
    with Simulator(RobotSettings(drive="ideal")) as simulator:
        for episode in episodes:
            ticks = np.array(episode["out"]["ticks"])
            ticks[:, 3] = np.unwrap(ticks[:, 3])
            simulator.reset(course(*episode["episode"]["cyl"]), 0, ticks[0, 1:4])
            for now, after in pairwise(ticks):
                simulator.step(now[6:8], 0.05)
                np.testing.assert_allclose(simulator.pose, after[1:4], atol=1e-9)
                np.testing.assert_allclose(simulator.odom_twist, after[4:6], atol=1e-9)
            np.testing.assert_array_equal(simulator.odom_pose, simulator.pose)


def test_the_ideal_drive_notes_collisions() -> None:
    with Simulator(RobotSettings(drive="ideal")) as simulator:
        simulator.reset(course((1.0, 0.0, 0.075)), 0, np.zeros(3))
        for _ in range(60):
            simulator.step((0.5, 0.0), 0.05)
            assert simulator.collided == (simulator.pose[0] > 1.0 - 0.075 - 0.21)
        assert simulator.collided


def test_many_episodes_do_not_grow() -> None:
    worlds = generate_worlds(20)
    process = psutil.Process()
    with Simulator() as simulator:
        for k in range(150):
            simulator.reset(worlds[k % 20], k, START)
            simulator.step((0.5, 0.0), 0.1)
            if k == 40:
                before = process.memory_info().rss
        grown = process.memory_info().rss - before
    assert grown < 8e6, f"{grown / 1e6:.1f} MB over 110 episodes"


def test_misuse_is_named() -> None:
    with Simulator() as simulator:
        with pytest.raises(RuntimeError, match="call reset first"):
            simulator.step((0.0, 0.0), 0.02)
        with pytest.raises(ValueError, match="pose: got"):
            simulator.reset(EMPTY, 0, np.array([0.0, math.nan, 0.0]))
        with pytest.raises(ValueError, match="seed: got -1"):
            simulator.reset(EMPTY, -1, np.zeros(3))
        with pytest.raises(ValueError, match=r"pose: \(1, 0\) lies in an obstacle"):
            simulator.reset(course((1.0, 0.1, 0.075)), 0, np.array([1.0, 0.0, 0.0]))
        simulator.reset(EMPTY, 0, np.zeros(3))
        for dt_s in (0.0, -0.02, 0.0005, 0.0204999):
            with pytest.raises(ValueError, match="dt_s: got"):
                simulator.step((0.0, 0.0), dt_s)
        with pytest.raises(ValueError, match="command: got"):
            simulator.step((math.inf, 0.0), 0.02)
