"""The planner of one robot: costmaps, global plan, DWA and recoveries behind one object.

All coordinates are in the odom frame. Everything happens in C (`csrc/navigator.h`); this class checks
arguments and names things. The asynchronous calls (`add_scan`, `update_local_map`, `update_global_map`,
`plan`, `control`) are the threads of a ROS move_base, to be called at their own rates; `cycle` calls them once
in their ideal order.
"""

from __future__ import annotations

import math
from enum import IntEnum
from typing import Any

import numpy as np
from numpy.typing import NDArray

from appl_dist._native import Planner
from appl_dist.planner.dwa import DWA
from appl_dist.planner.planner_settings import PlannerSettings
from appl_dist.spec import LaserGeometry

Array = NDArray[np.float64]


class State(IntEnum):
    """State of the move_base loop."""

    IDLE = 0  # no goal yet
    PLANNING = 1  # waits for a global plan, or lost its valid command
    CONTROLLING = 2
    CLEARING = 3  # runs a recovery behaviour
    SUCCEEDED = 4
    ABORTED = 5  # out of recoveries: zero velocity until the next goal


class Navigator:
    """Plans for one robot; not thread-safe, but releases the GIL while it computes."""

    def __init__(
        self,
        settings: PlannerSettings = PlannerSettings(),
        laser: LaserGeometry = LaserGeometry(),
        values: Array | None = None,
    ) -> None:
        """`values` (n,) in the order of dwa.DWA, default the hand-tuned ones. ValueError names what cannot be."""
        self.settings = settings
        self._planner = Planner(settings, laser, _floats(DWA.defaults if values is None else values))

    @property
    def native(self) -> Planner:
        """The C planner behind this object, for the loop that runs both."""
        return self._planner

    def reset(self, goal: Array) -> None:
        """New goal (x, y, yaw): clears maps, plans, recoveries and the local planner's memory."""
        self._planner.reset(_floats(goal))

    def set_parameters(self, values: Array) -> None:
        """(n,) values in the order of dwa.DWA, in force from the next update and control cycle.

        As dynamic_reconfigure does: sample counts are truncated, max_vel_theta holds both ways, a changed
        inflation_radius re-inflates both maps at their next update. ValueError names a value out of range.
        """
        self._planner.set_parameters(_floats(values))

    def add_scan(self, ranges: NDArray[np.float32], pose: Array) -> None:
        """Newest scan (beams,) m, seen from robot `pose` (x, y, yaw). Not finite or <= 0: no return, dropped."""
        self._planner.add_scan(np.ascontiguousarray(ranges, np.float32), _floats(pose))

    def update_local_map(self, pose: Array) -> None:
        """Bring the local costmap to the newest scan and the robot's pose."""
        self._planner.update_local(_floats(pose))

    def update_global_map(self, pose: Array) -> None:
        """Bring the global costmap to the newest scan and the robot's pose."""
        self._planner.update_global(_floats(pose))

    def plan(self, pose: Array, now_s: float | None = None) -> bool:
        """Plan to the goal; the next control cycle takes the plan over. False when there is none."""
        return bool(self._planner.plan(_floats(pose), math.nan if now_s is None else now_s))

    def control(self, pose: Array, twist: Array, now_s: float) -> Array:
        """Command (v, ω) of one move_base cycle. `twist` (v, ω) from the odometry."""
        command: Array = self._planner.control(_floats(pose), _floats(twist), now_s)
        return command

    def cycle(self, ranges: NDArray[np.float32], pose: Array, twist: Array, now_s: float) -> Array:
        """Scan, local map, global map (every second call), plan, control: the command (v, ω)."""
        scan = np.ascontiguousarray(ranges, np.float32)
        command: Array = self._planner.cycle(scan, _floats(pose), _floats(twist), now_s)
        return command

    def local_goal_bearing(self, pose: Array, lookahead_m: float = 1.0) -> float:
        """Bearing, rad in the robot frame, of the plan's point `lookahead_m` of arc ahead; 0 with no plan."""
        return float(self._planner.bearing(_floats(pose), lookahead_m))

    @property
    def state(self) -> State:
        return State(self._planner.state)

    @property
    def recoveries(self) -> int:
        """Recovery behaviours started since the goal was set."""
        return int(self._planner.recoveries)

    @property
    def goal_reached(self) -> bool:
        """The last control cycle found the robot standing on the goal pose."""
        return bool(self._planner.status()["reached"])

    @property
    def command_valid(self) -> bool:
        """The last control cycle found a valid command (computeVelocityCommands returned true)."""
        return bool(self._planner.valid)

    @property
    def resolution_m(self) -> float:
        """Side of a cell of both costmaps."""
        return self.settings.resolution_m

    @property
    def path(self) -> Array:
        """(n, 2) newest global plan, robot first."""
        plan: Array = self._planner.latest_plan()
        return plan

    @property
    def local_costmap(self) -> NDArray[np.uint8]:
        """(rows, columns) costs: 0 free, 253 inscribed, 254 lethal. A copy."""
        costs: NDArray[np.uint8] = self._planner.map(True, False)
        return costs

    @property
    def local_origin(self) -> Array:
        """(2,) m, lower left corner of the local costmap."""
        origin: Array = self._planner.origin(True)
        return origin

    @property
    def global_costmap(self) -> NDArray[np.uint8]:
        """(rows, columns) costs, as `local_costmap`. A copy."""
        costs: NDArray[np.uint8] = self._planner.map(False, False)
        return costs

    @property
    def trajectory(self) -> Array:
        """(n, 3) x, y, yaw of the roll-out chosen last, for drawing."""
        points: Array = self._planner.best()
        return points

    @property
    def best_cost(self) -> float | None:
        """Cost of the roll-out the last control cycle chose; None when it chose none."""
        cost = float(self._planner.best_sample()[2])
        return None if math.isnan(cost) else cost

    @property
    def rollouts(self) -> int:
        """Samples the last control cycle evaluated."""
        return int(self._planner.rollouts)

    @property
    def rollout_steps(self) -> int:
        """Points the ROS code would simulate for those samples at most (it stops at the first collision)."""
        return int(self._planner.rollout_steps)

    @property
    def navfn_cells(self) -> int:
        """Cells the last global plan expanded (also where an unchanged map let it be reused)."""
        return int(self._planner.navfn_cells)

    @property
    def memory_bytes(self) -> int:
        """Address space set aside; the part touched is far smaller."""
        return int(self._planner.bytes)

    @property
    def debug(self) -> dict[str, Any]:
        """Flags and counts of the local planner, named as in ROS."""
        status: dict[str, Any] = self._planner.status()
        return status


def _floats(values: Any) -> Array:
    return np.ascontiguousarray(values, np.float64)
