"""One robot in one BARN world: command in; pose, odometry, scan and contact out.

Free motion is csrc/tyres.c in steps of 1 ms. Where the robot could touch something within the next 2 ms, pybullet
steps along with it: contacts found there change pose and velocity, and the tyre model goes on from them. Anywhere
else flat ground is all there is to touch, and pybullet is neither stepped nor, before an episode's first such place,
even given the world.
Frames: world = odom at reset; poses are x, y, yaw of base_link with a yaw that is not wrapped.
"""

from __future__ import annotations

import math
from types import TracebackType

import numpy as np
from numpy.typing import NDArray

from appl_dist._native import CONTACT_MS, Lidar, Robot, sine_cosine
from appl_dist.sim.bullet import BulletBody, Pose
from appl_dist.sim.robot import LidarSettings, RobotSettings
from appl_dist.sim.robots import ROBOTS
from appl_dist.sim.worlds import Floats, World

ROLLED_OVER_RAD = 1.0
CLEARANCE_LIMIT_M = 100.0
FARTHEST = 1e4  # m and rad: where numbers stop being a place
LONGEST_STEP_S = 60.0
OLDEST_COMMAND_S = 1e6


def _checked_cylinders(world: World) -> Floats:
    cylinders = np.array(world.cylinders, np.float64, order="C")
    if cylinders.ndim != 2 or cylinders.shape[1] != 3:
        raise ValueError(f"{world.name}: cylinders: got shape {cylinders.shape}; expected (n, 3) x, y, radius")
    sensible = (np.abs(cylinders) <= FARTHEST).all(axis=1) & (cylinders[:, 2] > 0.0)
    if not sensible.all():
        bad = int(np.argmin(sensible))
        raise ValueError(
            f"{world.name}: cylinder {bad}: got {cylinders[bad].tolist()}; "
            f"expected x, y within +-{FARTHEST:g} and radius > 0"
        )
    return cylinders


class Simulator:
    """A robot, its lidar and its world; several may live in one process.

    Deterministic: the same world, seed, pose and commands give the same bits, whatever was simulated before.
    """

    def __init__(self, robot: RobotSettings = RobotSettings(), lidar: LidarSettings = LidarSettings()) -> None:  # noqa: B008
        self.robot, self.lidar = robot, lidar
        model = ROBOTS.get(robot.name)
        vehicle = model.vehicle(robot)
        self._robot = Robot(vehicle)
        self._caster = lidar.native()
        self._half_separation, self._wheel_radius_m = 0.5 * vehicle.separation, model.wheel_radius_m
        self._body = None if robot.drive == "ideal" else BulletBody(model)
        self._cylinders = np.empty((0, 3))
        self._seed = 0
        self._ready = False

    def __enter__(self) -> Simulator:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def close(self) -> None:
        """Free the pybullet client."""
        self._ready = False
        if self._body is not None:
            self._body.close()

    def reset(self, world: World, seed: int, pose: NDArray) -> None:
        """Put the robot at rest at `pose` (3,) x, y, yaw in `world`; time and odometry start anew.

        Raises ValueError if the pose is not three sensible numbers or lies in an obstacle, or if the world's
        cylinders are not (n, 3) x, y, radius > 0.
        """
        start = np.array(pose, np.float64)
        if start.shape != (3,) or not (np.abs(start) <= FARTHEST).all():
            raise ValueError(f"pose: got {pose!r}; expected x, y, yaw, each within +-{FARTHEST:g}")
        if not 0 <= seed < 1 << 64:
            raise ValueError(f"seed: got {seed}; allowed 0..2^64-1")
        self._seed = seed
        self._cylinders = _checked_cylinders(world)
        self._robot.reset(start, seed, self._cylinders)
        if self.clearance_m < 0.0:
            raise ValueError(f"pose: ({start[0]:g}, {start[1]:g}) lies in an obstacle of {world.name}")
        self._built = False  # whether pybullet has this world yet
        self._ready = True

    def step(self, command: NDArray | tuple[float, float], dt_s: float, command_age_s: float = 0.0) -> None:
        """Drive dt_s, a multiple of 1 ms, on the last cmd_vel received: `command` (2,) v m/s, w rad/s.

        command_age_s: how long before this step it was received. Once older than the time-out (0.25 s), also
        within one long step, the robot brakes.
        """
        if not self._ready:
            raise RuntimeError("step: no world yet; call reset first")
        ms = round(1000.0 * dt_s) if 0.0 < dt_s <= LONGEST_STEP_S else 0
        if ms < 1 or abs(1000.0 * dt_s - ms) > 1e-6:
            raise ValueError(f"dt_s: got {dt_s!r}; allowed multiples of 0.001 s up to {LONGEST_STEP_S:g} s")
        if not 0.0 <= command_age_s <= OLDEST_COMMAND_S:
            raise ValueError(f"command_age_s: got {command_age_s!r}; allowed 0..{OLDEST_COMMAND_S:g} s")
        v, w = float(command[0]), float(command[1])
        if not (math.isfinite(v) and math.isfinite(w)):
            raise ValueError(f"command: got ({v}, {w}); both must be finite")
        self._robot.command(v, w, round(1000.0 * command_age_s))
        while (ms := ms - self._robot.drive(ms)) > 0:
            step_ms = min(ms, CONTACT_MS)
            self.contact_step(step_ms)
            ms -= step_ms

    @property
    def native(self) -> tuple[Robot, Lidar]:
        """The C robot and lidar behind this object, for the loop that runs them with a planner."""
        return self._robot, self._caster

    def contact_step(self, ms: int) -> None:
        """One step where contacts are possible: predict freely, let pybullet resolve, correct."""
        body, robot = self._body, self._robot
        assert body is not None, "the ideal drive has no contacts"
        before = robot.pose
        if not self._built:
            body.rebuild(self._cylinders, before)
            self._built = True
        elif robot.landed:
            body.land()
        velocity = robot.predict(ms)
        motion = body.step(before, velocity, self._wheel_rates(), 1e-3 * ms)
        rolled_over = body.tilt_rad > ROLLED_OVER_RAD
        robot.resolve(body.touching, body.held, rolled_over, body.ground_force_n, *motion)

    def _wheel_rates(self) -> tuple[float, float]:
        v, w = self._robot.wheels
        turn = w * self._half_separation
        return (v - turn) / self._wheel_radius_m, (v + turn) / self._wheel_radius_m

    def scan(self) -> NDArray[np.float32]:
        """(beams,) ranges in m at this moment, inf = no return; noise is a function of (seed, time, beam) alone."""
        return self.scan_from(self._robot.pose, self._robot.time_ms)

    def scan_from(self, pose: Pose, time_ms: int) -> NDArray[np.float32]:
        """The scan of a moment gone by, from the true pose then: a scan that nobody reads need not be cast."""
        x, y, yaw = pose
        mount = self.lidar.mount_x_m
        sine, cosine = sine_cosine(yaw)
        lidar = np.array((x + mount * cosine, y + mount * sine, yaw))
        ranges = np.empty(self.lidar.beams, np.float32)
        self._caster.cast(lidar, self._cylinders, self._seed, time_ms, ranges)
        return ranges

    @property
    def position(self) -> tuple[float, float]:
        """True x, y of base_link, world frame."""
        x, y, _ = self._robot.pose
        return x, y

    @property
    def pose(self) -> Floats:
        """(3,) true x, y, yaw of base_link, world frame."""
        return np.array(self._robot.pose)

    @property
    def twist(self) -> Floats:
        """(2,) true forward speed of base_link and yaw rate."""
        forward, _, w = self._robot.twist
        return np.array((forward, w))

    @property
    def side_speed_mps(self) -> float:
        """True speed of base_link to its left: the drift that wheel odometry does not see."""
        return float(self._robot.twist[1])

    @property
    def wheel_twist(self) -> Floats:
        """(2,) forward speed and yaw rate the wheels turn for: the command after the controller's limits."""
        return np.array(self._robot.wheels)

    @property
    def tilt_rad(self) -> float:
        """Angle between the robot's and the world's vertical axis."""
        return 0.0 if self._body is None or self._robot.landed else self._body.tilt_rad

    @property
    def in_collision(self) -> bool:
        """Whether the robot touches an obstacle now."""
        return bool(self._robot.in_collision)

    @property
    def collided(self) -> bool:
        """Whether the robot has touched an obstacle since reset."""
        return bool(self._robot.collided)

    @property
    def rolled_over(self) -> bool:
        """Whether the robot has fallen over since reset."""
        return bool(self._robot.rolled_over)

    @property
    def odom_pose(self) -> Floats:
        """(3,) x, y by odometry: wheel speed integrated along the true yaw, from the true start; yaw with noise."""
        return np.array(self._robot.odom_pose)

    @property
    def odom_twist(self) -> Floats:
        """(2,) forward speed and yaw rate as odometry publishes them: filtered, every 20 ms."""
        return np.array(self._robot.odom_twist)

    @property
    def time_s(self) -> float:
        """Simulated time since reset."""
        return 1e-3 * self._robot.time_ms

    @property
    def distance_m(self) -> float:
        """True distance driven since reset."""
        return float(self._robot.distance)

    @property
    def clearance_m(self) -> float:
        """Distance from the hull (chassis and wheels) to the nearest obstacle, negative inside, at most 100."""
        return float(self._robot.clearance(CLEARANCE_LIMIT_M))
