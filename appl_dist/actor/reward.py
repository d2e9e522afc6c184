"""The reward of the parameter-selection MDP (APPLR, Sec. III-B)."""

from __future__ import annotations

import math
from dataclasses import dataclass

MIN_DISTANCE_M = 0.05  # keeps 1/d bounded in contact


@dataclass(frozen=True)
class RewardSettings:
    """Coefficients of R = c_f R_f + c_p R_p + c_c R_c, which the papers do not publish.

    Time counts 1 a decision, progress 1 a metre, so a trial's undiscounted return is its length in metres minus its
    decisions; the collision term (about -3 in a gap, before its coefficient) stays a tenth of either.
    """

    time: float = 1.0
    progress: float = 1.0
    collision: float = 0.03

    def __post_init__(self) -> None:
        for name in ("time", "progress", "collision"):
            if not 0.0 <= getattr(self, name) <= 1000.0:
                raise ValueError(f"reward.{name}: got {getattr(self, name)}; allowed 0..1000")


def reward(
    settings: RewardSettings,
    before: tuple[float, float],
    after: tuple[float, float],
    goal: tuple[float, float],
    nearest_m: float,
    reached: bool,
) -> float:
    """Reward of one decision.

    before, after, goal: x, y in one frame, m. nearest_m: the shortest of the 720 beams after the step.
    R_f = 1[reached] - 1; R_p = (p' - p) . (goal - p) / |goal - p|; R_c = -1 / nearest_m.
    """
    gx, gy = goal[0] - before[0], goal[1] - before[1]
    distance = math.hypot(gx, gy)
    forward = ((after[0] - before[0]) * gx + (after[1] - before[1]) * gy) / distance if distance > 0.0 else 0.0
    r_f = 0.0 if reached else -1.0
    r_c = -1.0 / max(nearest_m, MIN_DISTANCE_M)
    return settings.time * r_f + settings.progress * forward + settings.collision * r_c
