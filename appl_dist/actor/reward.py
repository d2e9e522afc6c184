"""Rewards of the parameter-selection MDP: APPLR's (Sec. III-B), and REWARDS, where a user adds his own."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

from appl_dist.registry import Registry

MIN_DISTANCE_M = 0.05  # keeps 1/d bounded in contact


@dataclass(frozen=True)
class RewardSettings:
    """Coefficients of R = c_f R_f + c_p R_p + c_c R_c, which the papers do not publish.

    Time counts 1 a decision, progress 1 a metre, so a trial's undiscounted return is its length in metres minus its
    decisions; the collision term (about -3 in a gap, before its coefficient) stays a tenth of either.
    name: an entry of REWARDS; one of a user's own may read the coefficients or not.
    """

    name: str = "appl"
    time: float = 1.0
    progress: float = 1.0
    collision: float = 0.03

    def __post_init__(self) -> None:
        for name in ("time", "progress", "collision"):
            if not 0.0 <= getattr(self, name) <= 1000.0:
                raise ValueError(f"reward.{name}: got {getattr(self, name)}; allowed 0..1000")


class Outcome(NamedTuple):
    """What one decision came to. Places are x, y in the world frame, m."""

    before: tuple[float, float]
    after: tuple[float, float]
    goal: tuple[float, float]
    nearest_m: float  # the shortest beam after the step
    reached: bool  # the goal
    collided: bool  # since the start of the episode


def appl_reward(settings: RewardSettings, step: Outcome) -> float:
    """R_f = 1[reached] - 1; R_p = (p' - p) . (goal - p) / |goal - p|; R_c = -1 / nearest."""
    gx, gy = step.goal[0] - step.before[0], step.goal[1] - step.before[1]
    distance = math.hypot(gx, gy)
    moved = (step.after[0] - step.before[0]) * gx + (step.after[1] - step.before[1]) * gy
    progress = moved / distance if distance > 0.0 else 0.0
    r_f = 0.0 if step.reached else -1.0
    r_c = -1.0 / max(step.nearest_m, MIN_DISTANCE_M)
    return settings.time * r_f + settings.progress * progress + settings.collision * r_c


REWARDS: Registry[Callable[[RewardSettings, Outcome], float]] = Registry("reward", {"appl": appl_reward})
