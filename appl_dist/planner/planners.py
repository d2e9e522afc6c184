"""What a robot drives with: the interface of a planner, and PLANNERS, where a user adds his own.

A planner is the threads of a ROS move_base: each of its calls comes at a rate of its own (actor/timing.py). All
coordinates are in the odometry frame, m and rad.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from appl_dist.errors import UserError
from appl_dist.planner import dwa
from appl_dist.planner.navigator import Navigator
from appl_dist.planner.planner_settings import PlannerSettings
from appl_dist.registry import Registry
from appl_dist.spec import FloatArray, LaserGeometry, ParameterSpace

Array = NDArray[np.float64]


class Planner(Protocol):
    """Plans for one robot. The C loop calls a planner in C directly, if it gives its `native` one, or else this."""

    def reset(self, goal: Array) -> None:
        """New goal (x, y, yaw): forgets maps, plans and recoveries."""
        ...

    def set_parameters(self, values: Array) -> None:
        """(n,) values of all the planner's parameters, in the order of `PlannerKind.parameters`."""
        ...

    def add_scan(self, ranges: FloatArray, pose: Array) -> None:
        """Newest scan (beams,) m, inf = no return, seen from robot `pose` (3,)."""
        ...

    def update_local_map(self, pose: Array) -> None:
        """Bring the local map to the newest scan and the robot's pose (3,)."""
        ...

    def update_global_map(self, pose: Array) -> None:
        """Bring the global map to the newest scan and the robot's pose (3,)."""
        ...

    def plan(self, pose: Array, now_s: float | None = None) -> bool:
        """Plan to the goal; whether there is a plan."""
        ...

    def control(self, pose: Array, twist: Array, now_s: float) -> Array:
        """The command (v, ω), finite. `twist` (2,) v, ω from the odometry."""
        ...

    def local_goal_bearing(self, pose: Array, lookahead_m: float = 1.0) -> float:
        """Bearing, rad in the robot frame, of the plan's point `lookahead_m` of arc ahead; 0 with no plan."""
        ...

    @property
    def rollout_steps(self) -> int:
        """Points that the last control cycle simulated; they become computing time."""
        ...

    @property
    def recoveries(self) -> int:
        """Recovery behaviours started since the goal was set."""
        ...


@runtime_checkable
class DrawnPlanner(Protocol):
    """What pictures and films show of a planner, beyond what driving needs."""

    @property
    def resolution_m(self) -> float:
        """Side of a cell of the local map."""
        ...

    @property
    def path(self) -> Array:
        """(n, 2) the global plan."""
        ...

    @property
    def trajectory(self) -> Array:
        """(n, 3) x, y, yaw of the local plan."""
        ...

    @property
    def local_costmap(self) -> NDArray[np.uint8]:
        """(rows, columns) costs: 0 free, 253 inscribed, 254 lethal."""
        ...

    @property
    def local_origin(self) -> Array:
        """(2,) lower left corner of the local map."""
        ...


@dataclass(frozen=True)
class PlannerKind:
    """A planner to choose. make: builds one for a lidar.

    spaces: the boxes in which a policy may move parameters; the first is the default. It holds all parameters that
        `Planner.set_parameters` takes, in their order.
    """

    make: Callable[[PlannerSettings, LaserGeometry], Planner]
    spaces: tuple[ParameterSpace, ...]

    @property
    def parameters(self) -> ParameterSpace:
        """All parameters of the planner, in the order that it takes."""
        return self.spaces[0]

    def space(self, name: str) -> ParameterSpace:
        """The box of that name; UserError lists the names."""
        for space in self.spaces:
            if space.name == name:
                return space
        raise UserError(f"env.space: got {name!r}; allowed {', '.join(s.name for s in self.spaces)}")


PLANNERS: Registry[PlannerKind] = Registry(
    "planner", {dwa.NAME: PlannerKind(make=Navigator, spaces=(dwa.DWA, dwa.DWA_WIDE))}
)
