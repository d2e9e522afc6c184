"""The robot as a pybullet body among cylinders: contacts, and what they do to its motion.

Traction does not come from here. Wheels and ground are frictionless in pybullet; the tyre forces of
csrc/tyres.c move the robot, and this body is given the velocity they give, so that only contacts with obstacles
(and the ground, in height and tilt) change its motion. Wheels spin as commanded and have their friction against
obstacles; how hard they stand on the ground is told to the tyre model, for a robot that climbs has less grip. Solver
and friction are as in Gazebo's ODE: 50 iterations, a friction pyramid, motors without a torque limit. Where nothing is
in reach there is nothing to resolve, and the body is left where it was.
"""

from __future__ import annotations

import math
import os
from types import ModuleType
from typing import NamedTuple

from appl_dist._native import sine_cosine
from appl_dist.sim.robot import RobotModel
from appl_dist.sim.worlds import Floats

CYLINDERS_PER_BODY = 16  # the most createCollisionShapeArray takes
CYLINDER_LENGTH_M = 1.0  # centred on the ground plane, as in the world files
SOLVER_ITERATIONS = 50  # as Gazebo's
WHEEL_JOINTS = (0, 1, 2, 3)  # front left, front right, rear left, rear right
# N m: the URDF sets no effort limit. A wheel that stalled in a collision would not climb the obstacle as Gazebo's does.
WHEEL_TORQUES = (1e6,) * 4
FLAT_RAD = 1e-3  # less tilt than this is bullet's contact slop, and is taken out


def _import_quietly() -> ModuleType:
    """pybullet, without the line about its build time that importing it writes to stderr."""
    saved, null = os.dup(2), os.open(os.devnull, os.O_WRONLY)
    os.dup2(null, 2)
    try:
        import pybullet

        return pybullet
    finally:
        os.dup2(saved, 2)
        os.close(saved)
        os.close(null)


p = _import_quietly()

Pose = tuple[float, float, float]  # x, y, yaw of base_link, or their rates


class Motion(NamedTuple):
    """Where base_link is after a step, and how contacts changed its planar velocity; world frame."""

    x: float
    y: float
    yaw: float
    dvx: float
    dvy: float
    dw: float


class BulletBody:
    """One robot and the obstacles of one world in an own pybullet client."""

    def __init__(self, model: RobotModel) -> None:
        self._model = model
        self._client = p.connect(p.DIRECT)
        if self._client < 0:
            raise RuntimeError("pybullet: no client left in this process; close simulators that are done")
        self._robot = self._ground = -1
        self._com = (0.0, 0.0, 0.0)  # of the base body, in base_link
        self._dt_s = 0.0
        self._wheels = (0.0, 0.0)
        self.tilt_rad = 0.0
        self.touching = False  # an obstacle, in the last step
        self.held = False  # contacts, not the tyre model, have the last word on where the robot is
        self._vertical = (0.0, 0.0, 0.0)  # vz and the roll and pitch rates, world frame
        self.ground_force_n = 0.0  # in the last step
        self._height = 0.0  # of the base body's centre of mass

    def close(self) -> None:
        """Leave pybullet; safe to call twice."""
        if self._client >= 0:
            p.disconnect(physicsClientId=self._client)
            self._client = -1

    def rebuild(self, cylinders: Floats, pose: Pose) -> None:
        """Start a fresh world, (n, 3) x, y, radius, with the robot at rest at x, y, yaw.

        Everything is built anew (8 ms): a world that outlives an episode keeps contact caches and body numbers,
        and the same episode would differ in its last bits.
        """
        client = self._client
        p.resetSimulation(physicsClientId=client)
        p.setGravity(0.0, 0.0, -9.8, physicsClientId=client)
        p.setPhysicsEngineParameter(
            numSolverIterations=SOLVER_ITERATIONS,
            enableConeFriction=0,  # a pyramid, as in ODE
            deterministicOverlappingPairs=1,
            physicsClientId=client,
        )
        # Without a given visual shape pybullet tessellates one for every one: 5 ms a body, not 0.3.
        visual = p.createVisualShape(p.GEOM_BOX, halfExtents=[0.001] * 3, physicsClientId=client)
        plane = p.createCollisionShape(p.GEOM_PLANE, physicsClientId=client)
        self._ground = p.createMultiBody(0, plane, visual, physicsClientId=client)
        p.changeDynamics(self._ground, -1, lateralFriction=0.0, physicsClientId=client)
        for first in range(0, len(cylinders), CYLINDERS_PER_BODY):
            self._add_obstacles(cylinders[first : first + CYLINDERS_PER_BODY], visual)
        flags = p.URDF_USE_IMPLICIT_CYLINDER | p.URDF_USE_INERTIA_FROM_FILE
        self._robot = p.loadURDF(str(self._model.urdf), flags=flags, physicsClientId=client)
        for link in range(-1, p.getNumJoints(self._robot, physicsClientId=client)):
            friction = 1.0 if link < 0 else 0.5
            p.changeDynamics(
                self._robot,
                link,
                lateralFriction=friction,
                linearDamping=0.0,
                angularDamping=0.0,
                jointDamping=0.0,
                physicsClientId=client,
            )
        self._com = p.getDynamicsInfo(self._robot, -1, physicsClientId=client)[3]
        self._dt_s = 0.0
        self._wheels = (0.0, 0.0)
        self.land()
        self._place(pose)

    def _add_obstacles(self, cylinders: Floats, visual: int) -> None:
        n = len(cylinders)
        shape = p.createCollisionShapeArray(
            shapeTypes=[p.GEOM_CYLINDER] * n,
            radii=cylinders[:, 2].tolist(),
            lengths=[CYLINDER_LENGTH_M] * n,
            collisionFramePositions=[[x, y, 0.0] for x, y in cylinders[:, :2].tolist()],
            physicsClientId=self._client,
        )
        body = p.createMultiBody(0, shape, visual, physicsClientId=self._client)
        p.changeDynamics(body, -1, lateralFriction=1.0, physicsClientId=self._client)

    def _place(self, pose: Pose) -> None:
        x, y, yaw = pose
        s, c = sine_cosine(yaw)
        cx, cy, _ = self._com
        p.resetBasePositionAndOrientation(
            self._robot,
            (x + c * cx - s * cy, y + s * cx + c * cy, self._height),
            (0.0, 0.0, *sine_cosine(0.5 * yaw)),
            physicsClientId=self._client,
        )

    def land(self) -> None:
        """Forget the last contact: the next step starts level, at rest vertically, wheels on the ground."""
        self._height = self._model.base_height_m + self._com[2]
        self._vertical = (0.0, 0.0, 0.0)
        self.touching = self.held = False
        self.tilt_rad = 0.0

    def step(self, pose: Pose, velocity: Pose, wheels: tuple[float, float], dt_s: float) -> Motion:
        """Move for dt_s from `pose` (x, y, yaw) with base_link's mean velocity (vx, vy, yaw rate), world frame.

        wheels: angular speeds of the left and the right pair, rad/s. A body that is held by a contact or tilted
        goes on from where it is; otherwise it starts exactly at `pose`, flat.
        """
        client, robot = self._client, self._robot
        if not self.held:
            self._place(pose)
            self._vertical = (self._vertical[0], 0.0, 0.0)
        ux, uy = self._push(pose, velocity, wheels, dt_s)
        (bx, by, self._height), (qx, qy, qz, qw) = p.getBasePositionAndOrientation(robot, physicsClientId=client)
        (ax, ay, az), (gx, gy, gz) = p.getBaseVelocity(robot, physicsClientId=client)
        self._vertical = (az, gx, gy)
        self.tilt_rad = math.acos(max(-1.0, min(1.0, 1.0 - 2.0 * (qx * qx + qy * qy))))
        self._read_contacts()
        self.held = self.touching or self.tilt_rad > FLAT_RAD
        yaw = math.atan2(2.0 * (qw * qz + qx * qy), 1.0 - 2.0 * (qy * qy + qz * qz))
        yaw += 2.0 * math.pi * round((pose[2] - yaw) / (2.0 * math.pi))  # the yaw outside is not wrapped
        rx, ry = self._com_offset(yaw)
        dw = gz - velocity[2]
        return Motion(bx - rx, by - ry, yaw, ax - ux + dw * ry, ay - uy - dw * rx, dw)

    def _com_offset(self, yaw: float) -> tuple[float, float]:
        s, c = sine_cosine(yaw)
        return c * self._com[0] - s * self._com[1], s * self._com[0] + c * self._com[1]

    def _push(self, pose: Pose, velocity: Pose, wheels: tuple[float, float], dt_s: float) -> tuple[float, float]:
        """Step with base_link at `velocity`; returns the velocity given to the body's own centre of mass."""
        client, robot = self._client, self._robot
        if dt_s != self._dt_s:
            p.setTimeStep(dt_s, physicsClientId=client)
            self._dt_s = dt_s
        if wheels != self._wheels:
            left, right = self._wheels = wheels
            p.setJointMotorControlArray(
                robot,
                WHEEL_JOINTS,
                p.VELOCITY_CONTROL,
                targetVelocities=(left, right, left, right),
                forces=WHEEL_TORQUES,
                physicsClientId=client,
            )
        vx, vy, w = velocity
        rx, ry = self._com_offset(pose[2] + 0.5 * w * dt_s)  # at the heading of mid-step
        ux, uy = vx - w * ry, vy + w * rx
        vz, wx, wy = self._vertical
        p.resetBaseVelocity(robot, (ux, uy, vz), (wx, wy, w), physicsClientId=client)
        p.stepSimulation(physicsClientId=client)
        return ux, uy

    def _read_contacts(self) -> None:
        """Whether the last step's contacts hold one with an obstacle, and how hard the robot stands on the ground."""
        self.touching, self.ground_force_n = False, 0.0
        for contact in p.getContactPoints(bodyA=self._robot, physicsClientId=self._client):
            # [2] the other body, [8] distance, [9] normal force; bullet also lists pairs that are only near.
            if contact[2] == self._ground:
                self.ground_force_n += contact[9]
            elif contact[8] <= 0.0 or contact[9] > 0.0:
                self.touching = True

    def ray_ranges(self, starts: list[list[float]], ends: list[list[float]]) -> list[float]:
        """Fraction of each ray that is free, 1 = no hit: the slow twin csrc/lidar.c is tested against."""
        hits: list[float] = []
        for first in range(0, len(starts), p.MAX_RAY_INTERSECTION_BATCH_SIZE):
            batch = slice(first, first + p.MAX_RAY_INTERSECTION_BATCH_SIZE)
            hits += [hit[2] for hit in p.rayTestBatch(starts[batch], ends[batch], physicsClientId=self._client)]
        return hits
