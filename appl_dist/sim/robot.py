"""The Jackal and its lidar as numbers: Clearpath's jackal_description and jackal_control, BARN challenge."""

from __future__ import annotations

import math
from dataclasses import dataclass

from appl_dist._native import Lidar, VehicleSpec
from appl_dist.spec import LIDAR_BEAMS

DRIVES = ("tyres", "ideal")
TRACK_M = 0.37559
WHEEL_RADIUS_M = 0.098
BASE_HEIGHT_M = 0.0635  # base_link above the ground
# Chassis 16.523 kg, lidar body 1.1 kg, four wheels of 0.477 kg.
MASS_KG = 19.531
INERTIA_Z = 0.555  # kg m^2 about the centre of mass
# x, y in base_link, height above the ground. The masses give a height of 0.137; 0.145 is the one number fitted, to
# the last two of 144 steady velocities that were off by slightly more than 10 % (benchmarks/jackal_response.py).
COM_M = (0.01325, 0.0017, 0.145)


def _require(name: str, value: float, low: float, high: float) -> None:
    if not (math.isfinite(value) and low <= value <= high):
        raise ValueError(f"{name}: got {value!r}; allowed {low:g}..{high:g}")


@dataclass(frozen=True)
class RobotSettings:
    """How the robot drives: "tyres" slide as in Gazebo, "ideal" follows its limited command exactly."""

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

    def native(self) -> VehicleSpec:
        """The same as the C core's struct."""
        spec = VehicleSpec()
        spec.mass, spec.inertia_z = MASS_KG, INERTIA_Z
        spec.com_x, spec.com_y, spec.com_z = COM_M
        spec.wheel_x, spec.wheel_y, spec.wheel_half_width = 0.131, TRACK_M / 2, 0.020
        spec.friction = self.friction
        spec.separation = TRACK_M * self.separation_multiplier
        spec.max_v, spec.max_w = self.max_v_mps, self.max_w_radps
        spec.max_accel, spec.max_alpha = self.max_accel_mps2, self.max_alpha_radps2
        spec.timeout_ms = round(1000 * self.command_timeout_s)
        spec.ideal = int(self.drive == "ideal")
        spec.odom_gain_v, spec.odom_gain_w = self.odom_gain_v, self.odom_gain_w
        spec.odom_noise_w = self.odom_noise_w_radps
        spec.odom_noise_yaw = self.odom_noise_yaw_rad
        return spec


@dataclass(frozen=True)
class LidarSettings:
    """The Hokuyo UST-10LX as Gazebo simulates it; 0.305 m above the ground, level, looking ahead."""

    beams: int = LIDAR_BEAMS
    angle_min_rad: float = -2.35619
    angle_max_rad: float = 2.35619
    range_min_m: float = 0.1
    range_max_m: float = 30.0
    noise_m: float = 0.001  # standard deviation
    mount_x_m: float = 0.055  # in base_link

    def __post_init__(self) -> None:
        _require("lidar.beams", self.beams, 4, 100_000)
        _require("lidar.angle_min_rad", self.angle_min_rad, -math.pi, math.pi)
        _require("lidar.angle_max_rad", self.angle_max_rad, self.angle_min_rad + 1e-6, math.pi)
        _require("lidar.range_min_m", self.range_min_m, 0.0, 10.0)
        _require("lidar.range_max_m", self.range_max_m, self.range_min_m + 1e-6, 1000.0)
        _require("lidar.noise_m", self.noise_m, 0.0, 1.0)
        _require("lidar.mount_x_m", self.mount_x_m, -0.2, 0.2)

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
