"""The tyre model against Gazebo's recorded responses and against arithmetic."""

from __future__ import annotations

import csv
import math

import numpy as np
import pytest

from appl_dist._native import Robot
from appl_dist.sim.robot import RobotSettings
from appl_dist.sim.robots import JACKAL
from tests.shared_data import shared

NOTHING = np.empty((0, 3))


def drive(v: float, w: float, ms: int, heading: float = 0.0, vehicle: Robot | None = None) -> Robot:
    """A vehicle after `ms` of a command, from rest unless one is given."""
    if vehicle is None:
        vehicle = Robot(JACKAL.vehicle(RobotSettings()))
        vehicle.reset(np.array([0.0, 0.0, heading]), 0, NOTHING)
    for _ in range(ms):
        vehicle.command(v, w, 0)
        vehicle.drive(1)
    return vehicle


def gazebo(test: str) -> dict[tuple[float, float, str], dict[str, float]]:
    found: dict[tuple[float, float, str], dict[str, float]] = {}
    with shared("reference", "jackal_response.csv").open(newline="") as stream:
        for row in csv.DictReader(stream):
            if row["variant"] == "gazebo_world_pyramid" and row["test"] == test:
                key = (float(row["v_cmd"]), float(row["w_cmd"]), row["condition"])
                found.setdefault(key, {})[row["quantity"]] = float(row["value"])
    return found


def close(ours: float, theirs: float) -> bool:
    return abs(ours - theirs) <= max(0.02, 0.10 * abs(theirs))


def test_steady_motion_is_gazebos() -> None:
    """48 commands: forward and side speed and yaw rate within 10 % or 0.02."""
    wrong = []
    for (v, w, _), expected in gazebo("steady").items():
        vehicle = drive(v, w, 1500)
        twists = []
        for _ in range(2000):
            vehicle.command(v, w, 0)
            vehicle.drive(1)
            twists.append(vehicle.twist)
        for ours, name in zip(np.mean(twists, axis=0), ("vx_mean", "vy_mean", "w_mean"), strict=True):
            if not close(ours, expected[name]):
                wrong.append((v, w, name, ours, expected[name]))
    assert wrong == []


def test_braking_is_gazebos() -> None:
    for (v, _, condition), expected in gazebo("brake_heading").items():
        vehicle = drive(v, 0.0, 1000, float(condition.split()[1]))
        x, y, yaw = vehicle.pose
        before = vehicle.distance
        drive(0.0, 0.0, 1000, vehicle=vehicle)
        dx, dy = vehicle.pose[0] - x, vehicle.pose[1] - y
        assert close(vehicle.distance - before, expected["d"])
        assert close(math.cos(yaw) * dy - math.sin(yaw) * dx, expected["side"])


def test_friction_is_a_pyramid_along_the_world_axes() -> None:
    """mu g along an axis, sqrt(2) mu g along the diagonal; no more, whatever the wheels do."""
    for heading, limit in ((0.0, 4.9), (math.pi / 4, 4.9 * math.sqrt(2.0))):
        speed = drive(2.0, 0.0, 150, heading).twist[0]
        assert speed == pytest.approx(0.150 * limit, rel=0.03)


def test_turning_in_place_is_faster_along_the_axes() -> None:
    rates = {round(theirs["w_mean"], 2) for key, theirs in gazebo("in_place_vs_heading").items() if key[1] == 1.57}
    vehicle, own = drive(0.0, 1.57, 1000), []
    for _ in range(4000):
        vehicle.command(0.0, 1.57, 0)
        vehicle.drive(1)
        own.append(vehicle.twist[2])
    assert close(max(own), max(rates))
    assert close(min(own), min(rates))


def test_a_mirrored_command_gives_a_mirrored_motion() -> None:
    """Exactly so with the centre of mass on the axis; the contacts are solved one after another, hence not to bits."""
    spec = JACKAL.vehicle(RobotSettings())
    spec.com_y = 0.0
    ends = []
    for sign in (1.0, -1.0):
        vehicle = Robot(spec)
        vehicle.reset(np.zeros(3), 0, NOTHING)
        drive(0.8, 1.2 * sign, 1000, vehicle=vehicle)
        ends.append(np.array(vehicle.pose) * [1.0, sign, sign])
    np.testing.assert_allclose(ends[0], ends[1], atol=1e-4)


def test_a_quarter_turn_of_the_world_changes_nothing() -> None:
    a, b = drive(1.0, 1.57, 1200), drive(1.0, 1.57, 1200, math.pi / 2)
    x, y, yaw = a.pose
    np.testing.assert_allclose(b.pose, [-y, x, yaw + math.pi / 2], atol=1e-3)


def test_wheels_obey_the_controllers_limits() -> None:
    vehicle = drive(5.0, 9.0, 50)
    assert vehicle.wheels == pytest.approx((1.0, 1.25))
    assert drive(5.0, 9.0, 500).wheels == pytest.approx((2.0, 4.0))


def test_an_old_command_stops_the_wheels() -> None:
    vehicle = drive(0.5, 0.0, 500)
    vehicle.command(0.5, 0.0, 0)
    vehicle.drive(250)
    assert vehicle.wheels[0] == pytest.approx(0.5)
    vehicle.drive(25)
    assert vehicle.wheels[0] == pytest.approx(0.0, abs=1e-12)


def test_without_friction_the_robot_stays() -> None:
    vehicle = Robot(JACKAL.vehicle(RobotSettings(friction=0.0)))
    vehicle.reset(np.zeros(3), 0, NOTHING)
    assert drive(2.0, 1.0, 500, vehicle=vehicle).pose == (0.0, 0.0, 0.0)


def test_odometry_misses_what_the_tyres_slip() -> None:
    """Slalom at (2, 1): Gazebo's wheels count 15.90 m where the robot goes 15.42 m forward."""
    vehicle = drive(0.0, 0.0, 1)
    wheel = true = 0.0
    for k in range(8):
        for _ in range(1000):
            drive(2.0, (-1.0) ** k, 1, vehicle=vehicle)
            wheel += 1e-3 * vehicle.wheels[0]
            true += 1e-3 * vehicle.twist[0]
    expected = gazebo("odom_slalom_8s")[(2.0, 1.0, "")]
    assert close(wheel, expected["wheel_dist"])
    assert wheel - true == pytest.approx(expected["wheel_dist"] - expected["true_forward"], abs=0.15)


@pytest.mark.parametrize(("field", "value"), [("friction", -0.1), ("drive", "wheels"), ("odom_gain_v", 2.0)])
def test_settings_are_checked(field: str, value: object) -> None:
    with pytest.raises(ValueError, match=rf"robot\.{field}: got"):
        RobotSettings(**{field: value})
