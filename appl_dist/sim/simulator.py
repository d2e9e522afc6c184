"""One Jackal in one BARN world: command in; pose, odometry, scan and contact out.

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

from appl_dist._native import Vehicle
from appl_dist.sim.bullet import BulletBody, Pose
from appl_dist.sim.robot import WHEEL_RADIUS_M, LidarSettings, RobotSettings
from appl_dist.sim.worlds import Floats, World

CONTACT_MS = 2  # pybullet step where an obstacle is in reach; crashes at 2 m/s come out as with 1, and not with 4
GLIDE_MS = 20  # how often the ideal drive looks for collisions
HARDEST_N = 400.0  # twice the weight: more is a jolt of one step
NEAR_M = 0.02  # bullet's contacts begin to act at this distance
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
        self._vehicle = Vehicle(robot.native())
        self._caster = lidar.native()
        self._half_separation = 0.5 * robot.native().separation
        self._body = None if robot.drive == "ideal" else BulletBody()
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
        self._vehicle.reset(start, seed, self._cylinders)
        if self.clearance_m < 0.0:
            raise ValueError(f"pose: ({start[0]:g}, {start[1]:g}) lies in an obstacle of {world.name}")
        if self._body is not None:
            self._body.land()
        self._landed = True
        self._built = False  # whether pybullet has this world yet
        self._ready = True
        self.collided = False  # since reset
        self.in_collision = False  # now
        self.rolled_over = False  # since reset

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
        self._vehicle.command(v, w, round(1000.0 * command_age_s))
        if self._body is None:
            self._glide(ms)
        else:
            self._drive(ms, self._body)

    def _drive(self, ms: int, body: BulletBody) -> None:
        while ms > 0:
            done = 0 if body.held else self._vehicle.drive_free(ms, NEAR_M, CONTACT_MS)
            if done == 0:
                done = min(ms, CONTACT_MS)
                self._contact_step(done)
                self._landed = False
            elif not self._landed:
                body.land()
                self._landed = True
            ms -= done

    def _glide(self, ms: int) -> None:
        """The ideal drive goes through obstacles; touching one is all that is noted."""
        while ms > 0:
            chunk = min(ms, GLIDE_MS)
            self._vehicle.drive_free(chunk, 0.0, 1)
            self.in_collision = self.clearance_m <= 0.0
            self.collided |= self.in_collision
            ms -= chunk

    def _wheel_rates(self) -> tuple[float, float]:
        v, w = self._vehicle.wheels
        turn = w * self._half_separation
        return (v - turn) / WHEEL_RADIUS_M, (v + turn) / WHEEL_RADIUS_M

    def _contact_step(self, ms: int) -> None:
        """One step where contacts are possible: predict freely, let pybullet resolve, correct."""
        body, vehicle = self._body, self._vehicle
        assert body is not None
        before = vehicle.pose
        if not self._built:
            body.rebuild(self._cylinders, before)
            self._built = True
        velocity = vehicle.predict(ms)
        motion = body.step(before, velocity, self._wheel_rates(), 1e-3 * ms)
        self.in_collision = body.touching
        if body.held:
            vehicle.correct(*motion)
            vehicle.load(min(body.ground_force_n, HARDEST_N))
        self.collided |= self.in_collision
        self.rolled_over |= body.tilt_rad > ROLLED_OVER_RAD

    def scan(self) -> NDArray[np.float32]:
        """(720,) ranges in m at this moment, inf = no return; noise is a function of (seed, time, beam) alone."""
        return self.scan_from(self._vehicle.pose, self._vehicle.time_ms)

    def scan_from(self, pose: Pose, time_ms: int) -> NDArray[np.float32]:
        """The scan of a moment gone by, from the true pose then: a scan that nobody reads need not be cast."""
        x, y, yaw = pose
        mount = self.lidar.mount_x_m
        lidar = np.array((x + mount * math.cos(yaw), y + mount * math.sin(yaw), yaw))
        ranges = np.empty(self.lidar.beams, np.float32)
        self._caster.cast(lidar, self._cylinders, self._seed, time_ms, ranges)
        return ranges

    def readings(self) -> tuple[Pose, Pose, tuple[float, float]]:
        """`pose`, `odom_pose` and `odom_twist` as plain numbers, for who asks 50 times a second."""
        vehicle = self._vehicle
        return vehicle.pose, vehicle.odom_pose, vehicle.odom_twist

    @property
    def position(self) -> tuple[float, float]:
        """True x, y of base_link, world frame."""
        x, y, _ = self._vehicle.pose
        return x, y

    @property
    def motion(self) -> tuple[float, float, float, float, float]:
        """True x, y, yaw, forward speed and yaw rate, without an array."""
        forward, _, w = self._vehicle.twist
        return (*self._vehicle.pose, forward, w)

    @property
    def pose(self) -> Floats:
        """(3,) true x, y, yaw of base_link, world frame."""
        return np.array(self._vehicle.pose)

    @property
    def twist(self) -> Floats:
        """(2,) true forward speed of base_link and yaw rate."""
        forward, _, w = self._vehicle.twist
        return np.array((forward, w))

    @property
    def side_speed_mps(self) -> float:
        """True speed of base_link to its left: the drift that wheel odometry does not see."""
        return float(self._vehicle.twist[1])

    @property
    def wheel_twist(self) -> Floats:
        """(2,) forward speed and yaw rate the wheels turn for: the command after the controller's limits."""
        return np.array(self._vehicle.wheels)

    @property
    def tilt_rad(self) -> float:
        """Angle between the robot's and the world's vertical axis."""
        return 0.0 if self._body is None else self._body.tilt_rad

    @property
    def odom_pose(self) -> Floats:
        """(3,) x, y by odometry: wheel speed integrated along the true yaw, from the true start; yaw with noise."""
        return np.array(self._vehicle.odom_pose)

    @property
    def odom_twist(self) -> Floats:
        """(2,) forward speed and yaw rate as odometry publishes them: filtered, every 20 ms."""
        return np.array(self._vehicle.odom_twist)

    @property
    def time_s(self) -> float:
        """Simulated time since reset."""
        return 1e-3 * self._vehicle.time_ms

    @property
    def distance_m(self) -> float:
        """True distance driven since reset."""
        return float(self._vehicle.distance)

    @property
    def clearance_m(self) -> float:
        """Distance from the hull (chassis and wheels) to the nearest obstacle, negative inside, at most 100."""
        return float(self._vehicle.clearance(CLEARANCE_LIMIT_M))
