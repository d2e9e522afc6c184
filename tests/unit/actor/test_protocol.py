import math
from types import SimpleNamespace

import numpy as np
import pytest

from appl_dist.actor.protocol import PROTOCOLS, Protocol
from appl_dist.config import load
from appl_dist.errors import UserError
from appl_dist.sim.worlds import load_worlds
from tests.shared_data import shared

WORLD = SimpleNamespace(path_official=np.array([[-1.275, 5.175], [-2.0, 7.0], [-3.075, 9.525]]))


def test_appl_starts_before_the_paths_first_cell_and_aims_past_its_end() -> None:
    appl = PROTOCOLS.get("appl")
    assert appl.start(WORLD) == pytest.approx([-1.275, 4.075, math.pi / 2])
    assert appl.goal(WORLD) == pytest.approx([-3.075, 14.525])
    assert appl.rules(WORLD).success_y_m == 10.0
    assert (appl.limit_s, appl.failed_time_s) == (50.0, 70.0)


def test_challenge_is_ten_metres_and_stops_within_one() -> None:
    challenge = PROTOCOLS.get("challenge")
    assert challenge.start(WORLD) == pytest.approx([-2.25, 3.0, math.pi / 2])
    rules = challenge.rules(WORLD)
    assert (rules.goal_x_m, rules.goal_y_m) == pytest.approx((-2.25, 13.0))
    assert math.isnan(rules.success_y_m)
    assert rules.goal_radius_m == 1.0
    assert rules.collision_ends


def test_ros_jackal_counts_a_hundred_decisions_of_a_second() -> None:
    rules = PROTOCOLS.get("ros_jackal").rules(WORLD)
    assert (rules.limit_s, rules.success_y_m, rules.collision_ends) == (100.0, 11.0, False)


def test_a_configuration_chooses_registered_rules_by_name() -> None:
    for name in PROTOCOLS.names():
        assert load([f"protocol={name}"]).protocol == PROTOCOLS.get(name)


def test_a_rule_can_be_changed_and_then_shows() -> None:
    changed = load(["protocol.limit_s=80"]).protocol
    assert changed.differences(PROTOCOLS.get("appl")) == "limit_s 80.0 and 50.0"


@pytest.mark.parametrize(
    ("override", "words"),
    [
        ("protocol.limit_s=0", r"protocol\.limit_s: got 0.0; allowed 0.1"),
        ("protocol.metric=speed", "protocol.metric: got 'speed'; allowed time, score"),
        ("protocol.success_y_m=null", "no trial could succeed"),
        ("protocol.name='a b'", "protocol.name"),
    ],
)
def test_rules_that_cannot_be_are_refused(override: str, words: str) -> None:
    with pytest.raises(UserError, match=words):
        load([override])


def test_optimal_times_are_the_published_ones() -> None:
    with np.load(shared("barn", "barn_paths.npz")) as published:
        before_2024, since_2024 = published["optimal_time"], published["official_length_init_m2p25"] / 2.0
    worlds = load_worlds(shared("barn"))
    assert [PROTOCOLS.get("challenge_2022").optimal_time_s(w) for w in worlds] == pytest.approx(before_2024, rel=1e-6)
    assert [PROTOCOLS.get("challenge").optimal_time_s(w) for w in worlds] == pytest.approx(since_2024, rel=1e-6)


def test_rules_are_told_apart() -> None:
    appl = PROTOCOLS.get("appl")
    assert appl.differences(appl) == ""
    assert "limit_s 50.0 and 100.0" in appl.differences(PROTOCOLS.get("ros_jackal"))
    assert isinstance(appl, Protocol)
