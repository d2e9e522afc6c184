import math
from types import SimpleNamespace

import numpy as np
import pytest

from appl_dist.actor.protocol import PROTOCOLS

WORLD = SimpleNamespace(path_official=np.array([[-1.275, 5.175], [-2.0, 7.0], [-3.075, 9.525]]))


def test_appl_starts_before_the_paths_first_cell_and_aims_past_its_end() -> None:
    appl = PROTOCOLS["appl"]
    assert appl.start(WORLD) == pytest.approx([-1.275, 4.075, math.pi / 2])
    assert appl.goal(WORLD) == pytest.approx([-3.075, 14.525])
    assert not appl.succeeded(0.0, 10.0, appl.goal(WORLD))
    assert appl.succeeded(-4.0, 10.01, appl.goal(WORLD))
    assert (appl.limit_s, appl.failed_time_s) == (50.0, 70.0)


def test_challenge_is_ten_metres_and_stops_within_one() -> None:
    challenge = PROTOCOLS["challenge"]
    assert challenge.start(WORLD) == pytest.approx([-2.25, 3.0, math.pi / 2])
    goal = challenge.goal(WORLD)
    assert goal == pytest.approx([-2.25, 13.0])
    assert challenge.succeeded(-2.25, 12.01, goal)
    assert not challenge.succeeded(-2.25, 11.99, goal)
    assert challenge.collision_ends


def test_ros_jackal_counts_a_hundred_decisions_of_a_second() -> None:
    assert PROTOCOLS["ros_jackal"].limit_s == 100.0
    assert PROTOCOLS["ros_jackal"].succeeded(0.0, 11.1, np.zeros(2))
    assert not PROTOCOLS["ros_jackal"].collision_ends
