"""The real runner of trials: one environment and one set of policies in a worker process.

No scipy, matplotlib or torch here: workers import this module and start in about a second.
"""

from __future__ import annotations

import hashlib
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType
from typing import Any

from appl_dist.actor.env import NavigationEnv
from appl_dist.actor.protocol import APPL
from appl_dist.actor.rollout import EpisodeResult, run_episode
from appl_dist.errors import UserError
from appl_dist.evaluate.trials import Job, Method, Trial, encode_trace
from appl_dist.planner.planner_settings import PlannerSettings
from appl_dist.planner.planners import PLANNERS
from appl_dist.policy.load import Policy, load_policy
from appl_dist.policy.observation import ObservationSettings, layout_of
from appl_dist.sim.robot import LidarSettings
from appl_dist.sim.worlds import World, course_of
from appl_dist.spec import ParameterSpace

# Arguments of `NavigationEnv` that no trial depends on, or only by its policy.
_NO_MATTER = ("rewards", "space", "observation")


@dataclass(frozen=True)
class NavigationRunner:
    """A factory of runners that pickles: called in a worker, it builds the environments and the policies.

    `environment`: further arguments of `NavigationEnv` (protocol, timing, planner …), all frozen
    dataclasses or plain values.
    """

    worlds: tuple[World, ...]
    methods: tuple[Method, ...]
    environment: Mapping[str, Any]

    def __call__(self) -> _Runner:
        return _Runner(self)

    def config_hash(self) -> str:
        """Hash of all that trials depend on besides method, course, number and seed."""
        digest = hashlib.sha256()
        for name in sorted(self.environment):
            if name not in _NO_MATTER:
                digest.update(f"{name}={self.environment[name]!r};".encode())
        return digest.hexdigest()[:16]

    def courses(self) -> dict[int, str]:
        """A fingerprint of each world's geometry."""
        return {world.index: course_of(world) for world in self.worlds}


class _Runner:
    def __init__(self, settings: NavigationRunner) -> None:
        self._settings = settings
        self._protocol = settings.environment.get("protocol", APPL).name
        self._envs: dict[str, NavigationEnv] = {}  # by parameter space: methods may have different boxes
        self._policies = {}
        for m in settings.methods:
            policy, space = _load(m.spec, settings.environment)
            self._policies[m.label] = policy, self._env(space)

    def _env(self, space: ParameterSpace) -> NavigationEnv:
        if space.name not in self._envs:
            arguments = {**self._settings.environment, "space": space}
            self._envs[space.name] = NavigationEnv(self._settings.worlds, **arguments)
        return self._envs[space.name]

    def __call__(self, job: Job) -> Trial:
        policy, env = self._policies[job.method]
        return trial_of(job, self._protocol, run_episode(env, policy, seed=job.seed, world=job.world))


def trial_of(job: Job, protocol: str, result: EpisodeResult) -> Trial:
    """The row of an episode's result; the outcome names what ended it."""
    if result.success:
        outcome = "goal"
    elif result.rolled_over:
        outcome = "rollover"
    else:
        outcome = "timeout" if result.timeout else "collision"
    return Trial(
        method=job.method,
        policy=job.policy,
        protocol=protocol,
        world=job.world,
        course=job.course,
        trial=job.trial,
        seed=job.seed,
        success=bool(result.success),
        time_s=float(result.time_s),
        outcome=outcome,
        collisions=int(result.collisions),
        distance_m=float(result.distance_m),
        min_clearance_m=float(result.min_clearance_m),
        recoveries=int(result.recoveries),
        decisions=result.decisions,
        digest=result.digest,
        parameters=encode_trace(result.parameters),
    )


def make_methods(
    methods: Sequence[tuple[str, str]], environment: Mapping[str, Any] = MappingProxyType({})
) -> tuple[Method, ...]:
    """Check every (label, policy specification) by loading it; UserError before any process is started.

    environment: arguments of `NavigationEnv`. A policy in a file is fingerprinted by the file's content, any other by
    its specification.
    """
    if not methods:
        raise UserError("methods: got none; give at least one label and policy")
    labels = [label for label, _ in methods]
    for label in labels:
        if not label or labels.count(label) > 1 or not label.isprintable():
            raise UserError(f"methods: label {label!r} is empty or used twice; labels name the rows of results")
    result = []
    for label, spec in methods:
        _load(spec, environment)
        path = Path(spec.split(":", 1)[-1])
        content = path.read_bytes() if path.is_file() else spec.encode()
        result.append(Method(label, spec, hashlib.sha256(content).hexdigest()[:12]))
    return tuple(result)


def _load(spec: str, environment: Mapping[str, Any]) -> tuple[Policy, ParameterSpace]:
    """A policy and the box it acts in: another box of the same parameters where the environment's does not hold it."""
    kind = PLANNERS.get(environment.get("planner", PlannerSettings()).name)
    space = environment.get("space") or kind.parameters
    observation = environment.get("observation", ObservationSettings()).name
    beams = environment.get("lidar", LidarSettings()).beams
    try:
        return load_policy(spec, space, layout_of(observation, beams, space)), space
    except UserError:
        for other in kind.spaces:
            if other.names == space.names and other != space:
                with suppress(UserError):
                    return load_policy(spec, other, layout_of(observation, beams, other)), other
        raise
