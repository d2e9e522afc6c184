import pytest

from appl_dist.actor.reward import REWARDS, Outcome, RewardSettings

ONLY_TIME = RewardSettings(time=1.0, progress=0.0, collision=0.0)
ONLY_PROGRESS = RewardSettings(time=0.0, progress=1.0, collision=0.0)
ONLY_COLLISION = RewardSettings(time=0.0, progress=0.0, collision=1.0)


def reward(settings: RewardSettings, before, after, goal, nearest_m: float, *, reached: bool) -> float:
    return REWARDS.get("appl")(settings, Outcome(before, after, goal, nearest_m, reached, collided=False))


def test_time_costs_one_a_decision_until_the_goal() -> None:
    assert reward(ONLY_TIME, (0, 0), (0, 1), (0, 10), 2.0, reached=False) == -1.0
    assert reward(ONLY_TIME, (0, 0), (0, 1), (0, 10), 2.0, reached=True) == 0.0


def test_progress_is_the_projection_on_the_direction_of_the_goal() -> None:
    # 1 m along +x while the goal lies at 3-4-5: cos = 3/5.
    assert reward(ONLY_PROGRESS, (0, 0), (1, 0), (3, 4), 2.0, reached=False) == pytest.approx(0.6)
    assert reward(ONLY_PROGRESS, (0, 0), (0, -0.5), (0, 10), 2.0, reached=False) == pytest.approx(-0.5)


def test_collision_term_is_minus_one_over_the_nearest_beam_and_bounded_in_contact() -> None:
    assert reward(ONLY_COLLISION, (0, 0), (0, 0), (0, 1), 0.5, reached=False) == -2.0
    assert reward(ONLY_COLLISION, (0, 0), (0, 0), (0, 1), 0.0, reached=False) == pytest.approx(-20.0)


def test_at_the_goal_exactly_progress_is_zero() -> None:
    assert reward(ONLY_PROGRESS, (1, 1), (2, 1), (1, 1), 2.0, reached=True) == 0.0


def test_a_coefficient_out_of_range_is_named() -> None:
    with pytest.raises(ValueError, match=r"reward\.progress: got -1"):
        RewardSettings(progress=-1.0)
