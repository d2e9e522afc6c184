"""Whatever a caller hands the simulator: it is driven, or a ValueError names the argument; never a crash or a NaN."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from appl_dist.sim.robot import RobotSettings
from appl_dist.sim.simulator import Simulator
from tests.unit.sim.courses import EMPTY, course

anything = st.floats(allow_nan=True, allow_infinity=True)
mostly_sane = st.one_of(st.floats(-3.0, 3.0), st.floats(-3.0, 3.0), anything)
COURSE = course((1.0, 0.2, 0.075), (1.0, -0.4, 0.075), (-0.8, 0.1, 0.3))


def refusal_of(call: Callable[[], None]) -> str:
    """What the ValueError that `call` raises says; empty if it raises none."""
    try:
        call()
    except ValueError as error:
        return str(error)
    return ""


@pytest.fixture(scope="module", params=["tyres", "ideal"])
def simulator(request: pytest.FixtureRequest) -> Iterator[Simulator]:
    with Simulator(RobotSettings(drive=request.param)) as one:
        yield one


@settings(max_examples=60, deadline=None)
@given(
    pose=st.tuples(mostly_sane, mostly_sane, mostly_sane),
    steps=st.lists(
        st.tuples(
            mostly_sane,
            mostly_sane,
            st.one_of(st.integers(1, 300).map(lambda ms: 0.001 * ms), anything.filter(lambda t: not 1.0 < t < 60.0)),
            st.one_of(st.just(0.0), anything),
        ),
        max_size=8,
    ),
)
def test_it_drives_or_names_what_cannot_be(
    simulator: Simulator, pose: tuple[float, float, float], steps: list[tuple[float, float, float, float]]
) -> None:
    refusal = refusal_of(lambda: simulator.reset(COURSE, 0, np.array(pose)))
    if refusal:
        assert refusal.startswith("pose: ")
        return
    for v, w, dt_s, age_s in steps:
        time_s, before = simulator.time_s, simulator.pose
        refusal = refusal_of(partial(simulator.step, (v, w), dt_s, age_s))
        if refusal:
            assert refusal.startswith(("command: ", "dt_s: ", "command_age_s: "))
            assert simulator.time_s == time_s
            np.testing.assert_array_equal(simulator.pose, before)
        else:
            assert math.isfinite(v)
            assert math.isfinite(w)
            assert simulator.time_s == pytest.approx(time_s + dt_s)
        for value in (simulator.pose, simulator.twist, simulator.odom_pose, simulator.odom_twist):
            assert np.isfinite(value).all()
        assert not np.isnan(simulator.scan()).any()


@pytest.mark.parametrize(
    ("cylinders", "says"),
    [
        ([[math.nan, 0.0, 0.1]], "cylinder 0: got"),
        ([[5.0, 5.0, 0.1], [1.0, 0.0, 0.0]], "cylinder 1: got"),
        ([[1.0, 0.0, -0.1]], "cylinder 0: got"),
        ([[math.inf, 0.0, 0.1]], "cylinder 0: got"),
        ([[1e9, 0.0, 0.1]], "cylinder 0: got"),
        ([[1.0, 0.0]], r"cylinders: got shape \(1, 2\)"),
        ([], r"cylinders: got shape \(0,\)"),
    ],
)
def test_an_absurd_world_is_named(cylinders: list[list[float]], says: str) -> None:
    with Simulator() as simulator, pytest.raises(ValueError, match=says):
        simulator.reset(replace(EMPTY, cylinders=np.array(cylinders)), 0, np.zeros(3))


@pytest.mark.parametrize("speed", [0.5, 2.0, -2.0])
def test_pushed_on_against_a_wall_it_stays_finite_and_outside(speed: float) -> None:
    wall = course(*((x, y, 0.075) for x in np.arange(-1.0, 1.0, 0.15) for y in (1.0, -1.0)))
    with Simulator() as simulator:
        simulator.reset(wall, 0, np.array([0.0, 0.0, math.pi / 2]))
        for _ in range(100):
            simulator.step((speed, 0.0), 0.1)
            assert np.isfinite(simulator.pose).all()
            assert abs(simulator.pose[1]) < 1.0 - 0.075  # a robot that climbs comes nearer than a level one
