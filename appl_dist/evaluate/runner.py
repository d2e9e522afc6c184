"""The real runner of trials: one environment and one set of policies in a worker process.

No scipy, matplotlib or torch here: workers import this module and start in about a second.
"""

from __future__ import annotations

import hashlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from appl_dist.actor.env import NavigationEnv
from appl_dist.actor.policy import load_policy
from appl_dist.actor.rollout import EpisodeResult, run_episode
from appl_dist.errors import UserError
from appl_dist.evaluate.trials import Job, Method, Trial
from appl_dist.sim.worlds import World
from appl_dist.spec import DWA, ParameterSpace


@dataclass(frozen=True)
class NavigationRunner:
    """A factory of runners that pickles: called in a worker, it builds the environment and the policies.

    `environment`: further arguments of `NavigationEnv` (protocol, timing, planner …), all frozen
    dataclasses or plain values.
    """

    worlds: tuple[World, ...]
    methods: tuple[Method, ...]
    environment: Mapping[str, Any]

    def __call__(self) -> _Runner:
        return _Runner(self)

    def config_hash(self, seed: int) -> str:
        """Hash of all that a trial depends on besides its method, world index and number."""
        digest = hashlib.sha256(repr(seed).encode())
        for name in sorted(self.environment):
            digest.update(f"{name}={self.environment[name]!r};".encode())
        for world in sorted(self.worlds, key=lambda w: w.index):
            digest.update(repr(world.index).encode())
            digest.update(world.cylinders.tobytes())
            digest.update(world.path.tobytes())
        return digest.hexdigest()[:16]


class _Runner:
    def __init__(self, settings: NavigationRunner) -> None:
        self._env = NavigationEnv(settings.worlds, **settings.environment)
        space = settings.environment.get("space", DWA)
        self._policies = {m.label: load_policy(m.spec, space) for m in settings.methods}

    def __call__(self, job: Job) -> Trial:
        result = run_episode(self._env, self._policies[job.method], seed=job.seed, world=job.world)
        return trial_of(job, result)


def trial_of(job: Job, result: EpisodeResult) -> Trial:
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
        world=job.world,
        trial=job.trial,
        seed=job.seed,
        success=bool(result.success),
        time_s=float(result.time_s),
        outcome=outcome,
        collided=bool(result.collided),
        distance_m=float(result.distance_m),
        min_clearance_m=float(result.min_clearance_m),
        decisions=int(result.decisions),
        recoveries=int(result.recoveries),
    )


def make_methods(methods: Sequence[tuple[str, str]], space: ParameterSpace | None = None) -> tuple[Method, ...]:
    """Check every (label, policy specification) by loading it; UserError before any process is started.

    A policy in a file is fingerprinted by the file's content, any other by its specification.
    """
    if not methods:
        raise UserError("methods: got none; give at least one label and policy")
    labels = [label for label, _ in methods]
    for label in labels:
        if not label or labels.count(label) > 1 or "\n" in label:
            raise UserError(f"methods: label {label!r} is empty or used twice; labels name the rows of results")
    result = []
    for label, spec in methods:
        load_policy(spec, space or DWA)
        path = Path(spec.split(":", 1)[-1])
        content = path.read_bytes() if path.is_file() else spec.encode()
        result.append(Method(label, spec, hashlib.sha256(content).hexdigest()[:12]))
    return tuple(result)
