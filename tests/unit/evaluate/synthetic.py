"""A runner that needs no simulator: times drawn from the job's seed, faster for the method "fast"."""

from __future__ import annotations

import os
import time
from dataclasses import dataclass

import numpy as np

from appl_dist.errors import UserError
from appl_dist.evaluate.trials import Job, Trial


@dataclass(frozen=True)
class Synthetic:
    """A factory of itself. `fault`: what goes wrong in world 3; `delay_s`: real time a trial takes."""

    gain_s: float = 4.0
    fault: str = ""
    delay_s: float = 0.0

    def __call__(self) -> Synthetic.Runner:
        return Synthetic.Runner(self)

    @dataclass(frozen=True)
    class Runner:
        settings: Synthetic

        def __call__(self, job: Job) -> Trial:
            if job.world == 3 and self.settings.fault == "user error":
                raise UserError("policy: got nonsense")
            if job.world == 3 and self.settings.fault == "exception":
                raise ZeroDivisionError("in world 3")
            if job.world == 3 and self.settings.fault == "death":
                os._exit(7)
            time.sleep(self.settings.delay_s)
            return synthetic_trial(job, self.settings.gain_s)


def synthetic_trial(job: Job, gain_s: float) -> Trial:
    rng = np.random.default_rng(job.seed)
    time_s = 20.0 + 0.1 * job.world + 2.0 * float(rng.standard_normal())
    success = bool(rng.random() < 0.95)
    if job.method == "fast":
        time_s -= gain_s
    return Trial(
        method=job.method,
        policy=job.policy,
        world=job.world,
        trial=job.trial,
        seed=job.seed,
        success=success,
        time_s=time_s if success else 50.0,
        outcome="goal" if success else "timeout",
        collided=False,
        distance_m=6.0,
        min_clearance_m=0.1,
        decisions=10,
        recoveries=0,
    )


@dataclass(frozen=True)
class ReadEnvironment:
    """A runner whose jobs are names of environment variables."""

    def __call__(self) -> ReadEnvironment.Runner:
        return ReadEnvironment.Runner()

    class Runner:
        def __call__(self, name: str) -> tuple[str, str]:
            return name, os.environ.get(name, "")
