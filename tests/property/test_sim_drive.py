"""Whatever is commanded, wherever: the robot stays out of obstacles and physics stays within its bounds."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from appl_dist.sim.generate import generate_world
from appl_dist.sim.simulator import Simulator

commands = st.lists(st.tuples(st.floats(-3.0, 3.0), st.floats(-5.0, 5.0), st.integers(1, 400)), min_size=1, max_size=12)
MU_G = 4.9 * 1.03


@pytest.fixture(scope="module")
def simulator() -> Simulator:
    return Simulator()


@settings(max_examples=25, deadline=None)
@given(plan=commands, index=st.integers(0, 299), y=st.floats(1.0, 4.0), yaw=st.floats(-4.0, 4.0))
def test_the_robot_never_enters_an_obstacle(
    simulator: Simulator, plan: list[tuple[float, float, int]], index: int, y: float, yaw: float
) -> None:
    simulator.reset(generate_world(index), 0, np.array([-2.25, y, yaw]))
    elapsed = 0
    for v, w, ms in plan:
        simulator.step((v, w), 0.001 * ms)
        elapsed += ms
        assert np.isfinite(simulator.pose).all()
        assert simulator.clearance_m > -0.03
        assert simulator.time_s == pytest.approx(0.001 * elapsed)
        assert simulator.collided or not simulator.in_collision
        assert abs(simulator.odom_pose[2] - simulator.pose[2]) < 6 * simulator.robot.odom_noise_yaw_rad


@settings(max_examples=40, deadline=None)
@given(plan=commands, yaw=st.floats(-4.0, 4.0))
def test_tyres_push_no_harder_than_friction(
    simulator: Simulator, plan: list[tuple[float, float, int]], yaw: float
) -> None:
    """Without obstacles the speed along a world axis changes by at most mu g t."""
    far = generate_world(0)
    simulator.reset(far, 0, np.array([200.0, 200.0, yaw]))
    before, driven = np.zeros(2), 0.0
    for v, w, ms in plan:
        place = simulator.pose[:2]
        for _ in range(ms):
            simulator.step((v, w), 0.001)
        turn = simulator.pose[2]
        forward, left = simulator.twist[0], simulator.side_speed_mps
        c, s = math.cos(turn), math.sin(turn)
        now = np.array([c * forward - s * left, s * forward + c * left])
        swing = 2 * 0.0134 * 8.0  # base_link is not the centre of mass
        assert (np.abs(now - before) <= MU_G * 0.001 * ms + swing).all()
        driven += float(np.hypot(*(simulator.pose[:2] - place)))
        before = now
    assert simulator.distance_m >= driven - 1e-9
    assert not simulator.collided
