"""The noise-free robot of the closed-loop reference vectors: an ideal drive and an exact lidar.

For replays only; trials and training use the simulator.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from appl_dist.spec import LaserGeometry

Array = NDArray[np.float64]

PHYSICS_STEP_S = 0.01
ACCELERATION = (20.0, 25.0)  # m/s^2, rad/s^2
RANGE_MAX_M = 30.0
CHASSIS_HALF_M = (0.508 / 2, 0.430 / 2)


def drive(pose: Array, twist: Array, command: Array, steps: int) -> tuple[Array, Array]:
    """Pose (3,) and twist (2,) after `steps` of 10 ms towards `command` (v, ω); midpoint heading."""
    x, y, yaw = (float(p) for p in pose)
    speed = [float(t) for t in twist]
    for _ in range(steps):
        for i in (0, 1):
            most = ACCELERATION[i] * PHYSICS_STEP_S
            speed[i] += max(-most, min(most, float(command[i]) - speed[i]))
        heading = yaw + speed[1] * PHYSICS_STEP_S / 2
        x += speed[0] * math.cos(heading) * PHYSICS_STEP_S
        y += speed[0] * math.sin(heading) * PHYSICS_STEP_S
        yaw += speed[1] * PHYSICS_STEP_S
        yaw = math.atan2(math.sin(yaw), math.cos(yaw))
    return np.array([x, y, yaw]), np.array(speed)


def cast_scan(cylinders: Array, pose: Array, laser: LaserGeometry) -> NDArray[np.float32]:
    """Ranges (beams,) m to cylinders (n, 3) x, y, radius; inf = no return."""
    beams, angle_max_rad = laser.beams, laser.angle_max_rad
    ox = pose[0] + laser.mount_x_m * math.cos(pose[2])
    oy = pose[1] + laser.mount_x_m * math.sin(pose[2])
    step = 2 * angle_max_rad / (beams - 1)
    fx, fy, radius = cylinders[:, 0] - ox, cylinders[:, 1] - oy, cylinders[:, 2]
    distance = np.hypot(fx, fy)
    half = np.where(distance > radius, np.arcsin(np.minimum(radius / np.maximum(distance, 1e-12), 1.0)), math.pi)
    centre = np.mod(np.arctan2(fy, fx) - pose[2] + angle_max_rad, 2 * math.pi)
    ranges = np.full(beams, np.inf)
    for turn in (0.0, -2 * math.pi):  # a cylinder may straddle the seam behind the robot
        first = np.clip(np.floor((centre + turn - half) / step).astype(int) - 1, 0, beams)
        last = np.clip(np.ceil((centre + turn + half) / step).astype(int) + 2, 0, beams)
        count = np.maximum(last - first, 0)
        which = np.repeat(np.arange(len(cylinders)), count)
        beam = np.arange(count.sum()) - np.repeat(np.cumsum(count) - count, count) + np.repeat(first, count)
        angle = pose[2] - angle_max_rad + beam * step
        dx, dy = np.cos(angle), np.sin(angle)
        along = fx[which] * dx + fy[which] * dy
        across = fx[which] * dy - fy[which] * dx
        inside = radius[which] ** 2 - across**2
        hit = along - np.sqrt(np.maximum(inside, 0.0))
        ok = (inside >= 0) & (hit > 0) & (hit <= RANGE_MAX_M)
        np.minimum.at(ranges, beam[ok], hit[ok])
    return ranges.astype(np.float32)


def clearance(cylinders: Array, pose: Array) -> float:
    """Distance, m, from the chassis rectangle to the nearest cylinder's surface; negative when they overlap."""
    c, s = math.cos(pose[2]), math.sin(pose[2])
    dx, dy = cylinders[:, 0] - pose[0], cylinders[:, 1] - pose[1]
    out_x = np.maximum(np.abs(dx * c + dy * s) - CHASSIS_HALF_M[0], 0.0)
    out_y = np.maximum(np.abs(-dx * s + dy * c) - CHASSIS_HALF_M[1], 0.0)
    return float(np.min(np.hypot(out_x, out_y) - cylinders[:, 2]))
