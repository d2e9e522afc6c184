"""Evaluation protocols: where a trial starts, when it succeeds, what ends it, how its time counts.

Times of different protocols do not compare. Coordinates are the BARN world frame (x right, y forward).
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from appl_dist.sim.worlds import World

FORWARD = math.pi / 2.0  # every protocol starts facing +y
APPL_START_Y_M = 4.075  # 1 m before the field's first column of cells as the papers draw it
PAST_PATH_END_M = 5.0  # `appl`, `ros_jackal`: the move_base goal lies this far past the path's end


@dataclass(frozen=True)
class Protocol:
    """One set of rules of a trial.

    start_x_m, start_y_m: start; None for x takes the x of the reference path's first cell, under the published
    transform (`World.path_official`): 0.15 m and 0.10 m off the cylinders, but the recorded runs started there.
    goal_ahead_m: goal = start + (0, goal_ahead_m); None puts it PAST_PATH_END_M past the path's end.
    success_y_m: success once y exceeds it; None succeeds within goal_radius_m of the goal instead.
    limit_s: time limit, counted (like the trial's time) from clock_starts_after_m of motion on.
    failed_time_s: the time a failed trial counts in means.
    collision_ends: any contact of robot and obstacle ends the trial. Roll-over always does.
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
    idle_limit_s: float = 20.0  # gives up when the clock never starts

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

    def succeeded(self, x: float, y: float, goal: NDArray[np.float64]) -> bool:
        if self.success_y_m is not None:
            return y > self.success_y_m
        return math.hypot(x - goal[0], y - goal[1]) < self.goal_radius_m


PROTOCOLS = {
    p.name: p
    for p in (
        Protocol("appl", None, APPL_START_Y_M, None, 10.0, 0.0, 50.0, 70.0, collision_ends=False),
        Protocol("ros_jackal", None, APPL_START_Y_M, None, 11.0, 0.0, 100.0, 100.0, collision_ends=False),
        Protocol(
            "challenge",
            -2.25,
            3.0,
            10.0,
            None,
            1.0,
            100.0,
            100.0,
            collision_ends=True,
            clock_starts_after_m=0.1,
        ),
    )
}
# The recorded Gazebo runs of default DWA started at x = -2 and stopped 0.5 m before the goal.
PROTOCOLS["challenge_2022"] = replace(PROTOCOLS["challenge"], name="challenge_2022", start_x_m=-2.0, goal_radius_m=0.5)
