"""Fixed planner settings: what the Jackal's yaml files say, plus the geometry of robot and maps.

The parameters that policies move are not here; they are in `dwa.py`. Names are those of the ROS
parameters where there is one (lengths m, angles rad, times s, speeds m/s and rad/s); others carry their unit.
Source: jackal_navigation (TrajectoryPlannerROS, costmap and move_base parameters) and
ros-planning/navigation for the defaults those files leave alone.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, get_args

Arithmetic = Literal["exact", "fast"]

# move_base's four recoveries: two clearings of a layer that does not exist, two rotations.
RECOVERY_BEHAVIOURS = 4


@dataclass(frozen=True)
class PlannerSettings:
    """Settings of TrajectoryPlannerROS, navfn, the two costmaps and move_base.

    name: an entry of PLANNERS (planners.py). Values are checked when a `Navigator` is made: ValueError names the field
    that cannot be.
    """

    name: str = "dwa"
    # TrajectoryPlannerROS
    acc_lim_x: float = 10.0
    acc_lim_theta: float = 20.0
    min_vel_x: float = 0.1  # slowest forward sample
    min_in_place_vel_theta: float = 0.314
    max_rotational_vel: float = 1.0  # of the final turn at the goal; not in the yaml, not tunable
    escape_vel: float = -0.5  # commanded when no sample is legal
    xy_goal_tolerance: float = 0.25
    yaw_goal_tolerance: float = 0.157
    rot_stopped_velocity: float = 0.01
    trans_stopped_velocity: float = 0.01
    sim_time: float = 2.0
    sim_granularity: float = 0.02
    angular_sim_granularity: float = 0.02
    controller_frequency: float = 20.0  # Hz; 1/f is the dynamic window's period
    heading_lookahead: float = 0.325
    oscillation_reset_dist: float = 0.05
    escape_reset_dist: float = 0.1
    escape_reset_theta: float = 0.1
    # pdist_scale and gdist_scale per metre (True) or per cell. Never initialised in the ROS code; True is what
    # reproduces recorded runs.
    meter_scoring: bool = True
    # Costmaps
    cost_scaling_factor: float = 10.0  # 1/m
    half_length_m: float = 0.21
    half_width_m: float = 0.165
    footprint_padding: float = 0.1
    local_size_m: float = 10.0  # square, follows the robot
    global_size_m: float = 40.0  # square, fixed
    global_origin_m: float = -20.0  # both coordinates of its lower left corner, odom
    resolution_m: float = 0.05
    obstacle_range: float = 2.5
    raytrace_range: float = 3.0
    # move_base
    controller_patience: float = 15.0
    planner_patience: float = 5.0
    rotate_max_vel_theta: float = 1.57  # rotate_recovery reads it once at start
    rotate_granularity_rad: float = 0.017
    # "exact": every plan and command is that of the ROS code, bit for bit. "fast", twice as fast: the global plan's
    # wave is in single precision and cut closer to what it needs, which moves plans by micrometres as a rule; costs are
    # those of the exact distance, not of the brushfire's (one inflated cell in some thousands).
    arithmetic: Arithmetic = "exact"

    def __post_init__(self) -> None:
        if self.arithmetic not in get_args(Arithmetic):
            raise ValueError(f"planner.arithmetic: got {self.arithmetic!r}; allowed {', '.join(get_args(Arithmetic))}")
