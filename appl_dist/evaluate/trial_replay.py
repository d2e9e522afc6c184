"""Any trial of an evaluation driven again from its row, and whether it is the same, bit for bit.

The row holds the parameter values of every decision, so no policy is needed: the same code, world and settings give
the same trial. What was planned and sensed can be recorded on the way, for films and figures.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, fields
from typing import Any

import numpy as np
from numpy.typing import NDArray

from appl_dist.actor.env import NavigationEnv
from appl_dist.actor.rollout import EpisodeResult, repeat_episode
from appl_dist.errors import UserError
from appl_dist.evaluate.folder import Evaluation
from appl_dist.evaluate.runner import NavigationRunner, course_of, trial_of
from appl_dist.evaluate.trials import Job, Trial, decode_trace
from appl_dist.planner.planners import DrawnPlanner
from appl_dist.sim.worlds import World

Array = NDArray[np.float64]
OpenEnv = Callable[[Evaluation], NavigationEnv]  # the environment of an evaluation, its worlds loaded


@dataclass(frozen=True)
class Frame:
    """One moment of a trial, in the world frame. parameters: (n,) in force.

    What the planner holds is in the odometry frame; it is moved by odometry's error of that moment, so that it lies
    about the robot as the planner sees it.

    pose (3,) x, y, yaw; twist (2,) v, w; scan (720,) m, inf = no return, with its angles and mount in `Recording`;
    plan (k, 2); trajectory (k, 2): the roll-out chosen last; costmap (rows, columns) with its lower left corner (2,).
    """

    t_s: float
    pose: Array
    twist: Array
    scan: NDArray[np.float32]
    plan: Array
    trajectory: Array
    costmap: NDArray[np.uint8]
    costmap_origin: Array
    parameters: Array
    recoveries: int


@dataclass(frozen=True)
class Recording:
    """A trial driven again. difference: "" if bit-equal to the row, else what is not."""

    trial: Trial
    world: World
    goal: Array
    result: EpisodeResult
    frames: tuple[Frame, ...]
    difference: str
    names: tuple[str, ...]  # of the parameters
    low: Array
    high: Array
    beam_angles: Array  # rad, robot frame
    lidar_x_m: float
    resolution_m: float
    period_s: float  # between decisions

    def scan_points(self, frame: Frame) -> Array:
        """(k, 2) world points where beams of `frame` ended."""
        hit = np.isfinite(frame.scan)
        x, y, yaw = frame.pose
        angles, ranges = yaw + self.beam_angles[hit], frame.scan[hit]
        lidar = np.array((x + self.lidar_x_m * np.cos(yaw), y + self.lidar_x_m * np.sin(yaw)))
        points: Array = lidar + ranges[:, None] * np.stack([np.cos(angles), np.sin(angles)], axis=1)
        return points


def find_trial(evaluation: Evaluation, name: str) -> Trial:
    """The trial a user names: METHOD/WORLD/TRIAL, or the number of its row, counted from 1. Raises UserError."""
    if name.isdigit():
        if not 1 <= int(name) <= len(evaluation.trials):
            raise UserError(f"row {name}: {evaluation.folder} has rows 1..{len(evaluation.trials)}")
        return evaluation.trials[int(name) - 1]
    method, _, rest = name.rpartition("/")
    method, _, world = method.rpartition("/")
    for t in evaluation.trials:
        if (t.method, str(t.world), str(t.trial)) == (method, world, rest):
            return t
    some = evaluation.trials[0] if evaluation.trials else None
    example = f", as in {trial_name(some)}" if some else ""
    raise UserError(
        f"{name}: no such trial in {evaluation.folder}; expected METHOD/WORLD/TRIAL or a row's number{example}"
    )


def trial_name(trial: Trial) -> str:
    return f"{trial.method}/{trial.world}/{trial.trial}"


def replay(env: NavigationEnv, trial: Trial, every_ms: int = 0) -> Recording:
    """Drive `trial` again in `env`; every_ms: simulated time between recorded frames, 0 for none.

    Raises UserError if the environment's world is not the trial's course.
    """
    world = env.worlds.get(trial.world)
    if world is None or course_of(world) != trial.course:
        raise UserError(f"{trial_name(trial)}: world {trial.world} is not the course of then; give the worlds of then")
    planner = env.loop.planner
    if not isinstance(planner, DrawnPlanner):
        raise UserError(f"{trial_name(trial)}: its planner shows nothing to draw; it lacks a path, a costmap or a plan")
    frames: list[Frame] = []
    due_ms = 0

    def record() -> None:
        nonlocal due_ms
        if env.loop.now_ms >= due_ms:
            due_ms = env.loop.now_ms + every_ms
            frames.append(_frame(env, planner))

    env.loop.on_sample = record if every_ms else None
    try:
        result = repeat_episode(env, decode_trace(trial.parameters), seed=trial.seed, world=trial.world)
        if every_ms:
            frames.append(_frame(env, planner))
        difference = ""
    except ValueError as error:
        raise UserError(
            f"{trial_name(trial)}: cannot be driven again ({error}); the code is not that of then"
        ) from None
    finally:
        env.loop.on_sample = None
    job = Job(trial.method, trial.policy, trial.world, trial.trial, trial.seed, trial.course)
    difference = _difference(trial, trial_of(job, trial.protocol, result))
    lidar = env.loop.simulator.lidar
    return Recording(
        trial=trial,
        world=world,
        goal=env.protocol.goal(world),
        result=result,
        frames=tuple(frames),
        difference=difference,
        names=env.space.names,
        low=env.space.low,
        high=env.space.high,
        beam_angles=np.linspace(lidar.angle_min_rad, lidar.angle_max_rad, lidar.beams),
        lidar_x_m=lidar.mount_x_m,
        resolution_m=planner.resolution_m,
        period_s=env.period_ms / 1000.0,
    )


def check_settings(evaluation: Evaluation, environment: dict[str, Any]) -> None:
    """UserError if `environment` is not what the trials were driven in."""
    if NavigationRunner((), (), environment).config_hash() != evaluation.config_hash:
        raise UserError(
            f"{evaluation.folder}: the settings now differ from those of its trials (other defaults in this version?); "
            "replay with the version that evaluated"
        )


def _difference(old: Trial, new: Trial) -> str:
    changed = [
        f"{f.name} {getattr(old, f.name)} is now {getattr(new, f.name)}"
        for f in fields(Trial)
        if f.name != "parameters" and getattr(old, f.name) != getattr(new, f.name)
    ]
    return ", ".join(changed)


def _frame(env: NavigationEnv, planner: DrawnPlanner) -> Frame:
    loop = env.loop
    simulator = loop.simulator
    drift = simulator.odom_pose[:2] - simulator.pose[:2]  # the axes of both frames stay parallel
    origin = env.protocol.start(env.world)[:2] - drift
    return Frame(
        t_s=loop.now_ms / 1000.0,
        pose=simulator.pose,
        twist=simulator.twist,
        scan=loop.scan,
        plan=planner.path + origin,
        trajectory=planner.trajectory[:, :2] + origin,
        costmap=planner.local_costmap,
        costmap_origin=planner.local_origin + origin,
        parameters=np.array(env.parameters),
        recoveries=loop.planner.recoveries,
    )
