"""What a robot with four skid-steered wheels and a lidar is in numbers: its model, how it drives, what it sees."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

from appl_dist._native import Lidar, VehicleSpec
from appl_dist.spec import LaserGeometry

DRIVES = ("tyres", "ideal")


def _require(name: str, value: float, low: float, high: float) -> None:
    if not (math.isfinite(value) and low <= value <= high):
        raise ValueError(f"{name}: got {value!r}; allowed {low:g}..{high:g}")


@dataclass(frozen=True)
class RobotModel:
    """The body of a robot: what no setting changes. Lengths in m, masses in kg; x ahead, y left, in base_link.

    urdf: its rigid bodies for contacts; its first four joints are the wheels: front left and right, rear left and
        right. It has to agree with the figures here.
    base_height_m: base_link above the ground. mass_kg, inertia_z_kgm2, com_m: of the whole robot, the inertia about
        the centre of mass; com_m: x, y in base_link, height above the ground.
    wheel_x_m, wheel_y_m: half the wheelbase and half the track; wheel_half_width_m; wheel_radius_m.
    chassis_half_m: half length and half width of the collision box.
    hull_radius_m: no point of chassis and wheels is farther from base_link.
    """

    urdf: Path
    base_height_m: float
    mass_kg: float
    inertia_z_kgm2: float
    com_m: tuple[float, float, float]
    wheel_x_m: float
    wheel_y_m: float
    wheel_half_width_m: float
    wheel_radius_m: float
    chassis_half_m: tuple[float, float]
    hull_radius_m: float

    def vehicle(self, settings: RobotSettings) -> VehicleSpec:
        """This robot, driving as `settings` say, as the C core's struct."""
        spec = VehicleSpec()
        spec.mass, spec.inertia_z = self.mass_kg, self.inertia_z_kgm2
        spec.com_x, spec.com_y, spec.com_z = self.com_m
        spec.wheel_x, spec.wheel_y = self.wheel_x_m, self.wheel_y_m
        spec.wheel_half_width, spec.wheel_radius = self.wheel_half_width_m, self.wheel_radius_m
        spec.chassis_x, spec.chassis_y = self.chassis_half_m
        spec.hull_radius = self.hull_radius_m
        spec.friction = settings.friction
        spec.separation = 2 * self.wheel_y_m * settings.separation_multiplier
        spec.max_v, spec.max_w = settings.max_v_mps, settings.max_w_radps
        spec.max_accel, spec.max_alpha = settings.max_accel_mps2, settings.max_alpha_radps2
        spec.timeout_ms = round(1000 * settings.command_timeout_s)
        spec.ideal = int(settings.drive == "ideal")
        spec.odom_gain_v, spec.odom_gain_w = settings.odom_gain_v, settings.odom_gain_w
        spec.odom_noise_w = settings.odom_noise_w_radps
        spec.odom_noise_yaw = settings.odom_noise_yaw_rad
        return spec


@dataclass(frozen=True)
class RobotSettings:
    """How the robot drives: "tyres" slide as in Gazebo, "ideal" follows its limited command exactly.

    name: a RobotModel of sim/robots.py. The other defaults are those of Clearpath's Jackal.
    """

    name: str = "jackal"
    drive: str = "tyres"
    friction: float = 0.5  # mu1 = mu2 of the wheels in the URDF
    max_v_mps: float = 2.0  # limits of diff_drive_controller, jackal_control/config/control.yaml
    max_w_radps: float = 4.0
    max_accel_mps2: float = 20.0
    max_alpha_radps2: float = 25.0
    separation_multiplier: float = 1.5
    command_timeout_s: float = 0.25
    # The EKF's twist in its steady state, updated every 20 ms: share of a new measurement, noise of the IMU.
    odom_gain_v: float = 0.5
    odom_gain_w: float = 0.95
    odom_noise_w_radps: float = 0.005
    odom_noise_yaw_rad: float = 0.005  # the IMU's heading noise, which the EKF follows

    def __post_init__(self) -> None:
        if self.drive not in DRIVES:
            raise ValueError(f"robot.drive: got {self.drive!r}; allowed {', '.join(DRIVES)}")
        _require("robot.friction", self.friction, 0.0, 2.0)
        _require("robot.max_v_mps", self.max_v_mps, 0.01, 5.0)
        _require("robot.max_w_radps", self.max_w_radps, 0.01, 10.0)
        _require("robot.max_accel_mps2", self.max_accel_mps2, 0.1, 1000.0)
        _require("robot.max_alpha_radps2", self.max_alpha_radps2, 0.1, 1000.0)
        _require("robot.separation_multiplier", self.separation_multiplier, 0.5, 3.0)
        _require("robot.command_timeout_s", self.command_timeout_s, 0.001, 1e6)
        _require("robot.odom_gain_v", self.odom_gain_v, 0.0, 1.0)
        _require("robot.odom_gain_w", self.odom_gain_w, 0.0, 1.0)
        _require("robot.odom_noise_w_radps", self.odom_noise_w_radps, 0.0, 1.0)
        _require("robot.odom_noise_yaw_rad", self.odom_noise_yaw_rad, 0.0, 0.5)


@dataclass(frozen=True)
class LidarSettings:
    """The Jackal's Hokuyo UST-10LX as Gazebo simulates it; 0.305 m above the ground, level, looking ahead."""

    beams: int = LaserGeometry.beams
    angle_min_rad: float = -LaserGeometry.angle_max_rad
    angle_max_rad: float = LaserGeometry.angle_max_rad
    range_min_m: float = 0.1
    range_max_m: float = 30.0
    noise_m: float = 0.001  # standard deviation
    mount_x_m: float = LaserGeometry.mount_x_m  # in base_link

    def __post_init__(self) -> None:
        _require("lidar.beams", self.beams, 4, 100_000)
        _require("lidar.angle_min_rad", self.angle_min_rad, -math.pi, math.pi)
        _require("lidar.angle_max_rad", self.angle_max_rad, self.angle_min_rad + 1e-6, math.pi)
        _require("lidar.range_min_m", self.range_min_m, 0.0, 10.0)
        _require("lidar.range_max_m", self.range_max_m, self.range_min_m + 1e-6, 1000.0)
        _require("lidar.noise_m", self.noise_m, 0.0, 1.0)
        _require("lidar.mount_x_m", self.mount_x_m, -0.2, 0.2)

    @property
    def geometry(self) -> LaserGeometry:
        """What a planner is told of this lidar. ValueError: it looks farther to one side than to the other."""
        if self.angle_min_rad != -self.angle_max_rad:
            raise ValueError(
                f"lidar.angle_min_rad: got {self.angle_min_rad}; planners need -angle_max_rad, {-self.angle_max_rad}"
            )
        return LaserGeometry(self.beams, self.mount_x_m, self.angle_max_rad)

    def native(self) -> Lidar:
        """The C ray caster of this lidar."""
        return Lidar(
            self.beams,
            self.angle_min_rad,
            self.angle_max_rad,
            self.range_min_m,
            self.range_max_m,
            self.noise_m,
        )
