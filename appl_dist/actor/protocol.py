"""Evaluation protocols: where a trial starts, when it succeeds, what ends it, how its time counts.

Times of different protocols do not compare: the robot drives 5.9, 6.9 or 10 m. Coordinates are the BARN world frame
(x right, y forward).
"""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from appl_dist.registry import Registry

if TYPE_CHECKING:
    from appl_dist.sim.worlds import World

FORWARD = math.pi / 2.0  # every protocol starts facing +y
APPL_START_Y_M = 4.075  # 1 m before the field's first column of cells as the papers draw it
PAST_PATH_END_M = 5.0  # `appl`, `ros_jackal`: the move_base goal lies this far past the path's end
OPTIMAL_SPEED_MPS = 2.0  # of the BARN Challenge's optimal time


@dataclass(frozen=True)
class TrialRules:
    """What the loop must know to end a trial; world frame, metres. success_y_m NaN: success is a matter of radius."""

    goal_x_m: float
    goal_y_m: float
    success_y_m: float
    goal_radius_m: float
    limit_s: float
    idle_limit_s: float
    clock_starts_after_m: float
    collision_ends: bool


@dataclass(frozen=True)
class Protocol:
    """One set of rules of a trial.

    start_x_m, start_y_m: start; None for x takes the x of the reference path's first cell, under the published
    transform (`World.path_official`): 0.15 m and 0.10 m off the cylinders, but the recorded runs started there.
    goal_ahead_m: goal = start + (0, goal_ahead_m); None puts it PAST_PATH_END_M past the path's end.
    success_y_m: success once y exceeds it; None succeeds within goal_radius_m of the goal instead.
    limit_s: time limit, counted (like the trial's time) from clock_starts_after_m of motion on; idle_limit_s: gives
    up when the clock never starts.
    failed_time_s: the time a failed trial counts in means.
    collision_ends: any contact of robot and obstacle ends the trial. Roll-over always does.
    metric: what the protocol ranks by. "time": mean traversal time. "score": mean of 1[success] OT / clip(time,
    score_clip_low OT, score_clip_high OT), OT = reference length / 2 m/s (BARN Challenge).
    """

    name: str
    start_x_m: float | None
    start_y_m: float
    goal_ahead_m: float | None
    success_y_m: float | None
    goal_radius_m: float
    limit_s: float
    failed_time_s: float
    collision_ends: bool
    clock_starts_after_m: float = 0.0
    idle_limit_s: float = 20.0
    metric: str = "time"
    score_clip_low: float = 2.0
    score_clip_high: float = 8.0

    def __post_init__(self) -> None:
        for name, low, high in (
            ("limit_s", 0.1, 3600.0),
            ("failed_time_s", 0.0, 1e5),
            ("goal_radius_m", 0.0, 10.0),
            ("clock_starts_after_m", 0.0, 10.0),
            ("idle_limit_s", 0.1, 3600.0),
            ("score_clip_low", 0.1, self.score_clip_high),
        ):
            if not low <= getattr(self, name) <= high:
                raise ValueError(f"protocol.{name}: got {getattr(self, name)}; allowed {low:g}..{high:g}")
        if not self.name or not self.name.isprintable() or " " in self.name:
            raise ValueError(f"protocol.name: got {self.name!r}; expected a word")
        if self.metric not in ("time", "score"):
            raise ValueError(f"protocol.metric: got {self.metric!r}; allowed time, score")
        if self.success_y_m is None and self.goal_radius_m == 0.0:
            raise ValueError("protocol.goal_radius_m: got 0 without success_y_m; no trial could succeed")

    def start(self, world: World) -> NDArray[np.float64]:
        """(3,) start pose x, y, yaw in the world frame."""
        x = float(world.path_official[0, 0]) if self.start_x_m is None else self.start_x_m
        return np.array([x, self.start_y_m, FORWARD])

    def goal(self, world: World) -> NDArray[np.float64]:
        """(2,) goal x, y in the world frame."""
        if self.goal_ahead_m is None:
            x, y = world.path_official[-1]
            return np.array([x, y + PAST_PATH_END_M])
        start = self.start(world)
        return np.array([start[0], start[1] + self.goal_ahead_m])

    def rules(self, world: World) -> TrialRules:
        """These rules in `world`."""
        x, y = self.goal(world)
        return TrialRules(
            float(x),
            float(y),
            math.nan if self.success_y_m is None else self.success_y_m,
            self.goal_radius_m,
            self.limit_s,
            self.idle_limit_s,
            self.clock_starts_after_m,
            self.collision_ends,
        )

    def optimal_time_s(self, world: World) -> float:
        """OT: start, reference path as the official scripts place it, goal, at OPTIMAL_SPEED_MPS."""
        way = np.vstack([self.start(world)[:2], world.path_official, self.goal(world)])
        return float(np.linalg.norm(np.diff(way, axis=0), axis=1).sum()) / OPTIMAL_SPEED_MPS

    def differences(self, other: Protocol) -> str:
        """The rules in which `other` differs, as a sentence's part; "" if in none."""
        a, b = asdict(self), asdict(other)
        return ", ".join(f"{k} {a[k]} and {b[k]}" for k in a if a[k] != b[k])


def _challenge(name: str, start_x_m: float, goal_radius_m: float, score_clip_low: float) -> Protocol:
    return Protocol(
        name=name,
        start_x_m=start_x_m,
        start_y_m=3.0,
        goal_ahead_m=10.0,
        success_y_m=None,
        goal_radius_m=goal_radius_m,
        limit_s=100.0,
        failed_time_s=100.0,
        collision_ends=True,
        clock_starts_after_m=0.1,
        metric="score",
        score_clip_low=score_clip_low,
    )


# The papers' tables (APPL journal Sec. V-D): 50 s, a failed trial counts 70 s, contacts do not end a trial; 5.9 m.
APPL = Protocol("appl", None, APPL_START_Y_M, None, 10.0, 0.0, 50.0, 70.0, collision_ends=False)
# The released code's evaluation: 100 decisions of a second, past y = 11 m; about 6.9 m.
_ROS_JACKAL = Protocol("ros_jackal", None, APPL_START_Y_M, None, 11.0, 0.0, 100.0, 100.0, collision_ends=False)
# BARN Challenge since 2024: any contact ends the trial; the score clips times at 2 and 8 optimal times. 9 to 10 m.
_CHALLENGE = _challenge("challenge", -2.25, 1.0, score_clip_low=2.0)
# BARN Challenge before 2024, clips at 4 and 8. The recorded Gazebo runs of default DWA started at x = -2 and stopped
# 0.5 m before the goal.
_CHALLENGE_2022 = _challenge("challenge_2022", -2.0, 0.5, score_clip_low=4.0)

# Where a user adds his own; a configuration chooses one by `protocol=NAME`.
PROTOCOLS: Registry[Protocol] = Registry(
    "protocol", {p.name: p for p in (APPL, _ROS_JACKAL, _CHALLENGE, _CHALLENGE_2022)}
)
