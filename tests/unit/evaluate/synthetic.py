"""A runner that needs no simulator: times drawn from the job's seed, faster for the method "fast"."""

from __future__ import annotations

import os
import signal
import time
from dataclasses import dataclass, replace
from pathlib import Path

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
            if job.world == 3 and self.settings.fault.startswith("killed once "):
                mark = Path(self.settings.fault.removeprefix("killed once "))
                if not mark.exists():
                    mark.touch()
                    os.kill(os.getpid(), signal.SIGKILL)
            time.sleep(self.settings.delay_s)
            return synthetic_trial(job, self.settings.gain_s)


def synthetic_trial(job: Job, gain_s: float) -> Trial:
    rng = np.random.default_rng(job.seed)
    time_s = 20.0 + 0.1 * job.world + 2.0 * float(rng.standard_normal())
    success = bool(rng.random() < 0.95)
    if job.method == "fast":
        time_s -= gain_s
    found = make_trial(job.method, job.world, job.trial, time_s if success else 50.0, success)
    return replace(found, policy=job.policy, course=job.course, seed=job.seed, digest=f"{job.seed:016x}")


def make_trial(method: str, world: int, number: int, time_s: float, success: bool = True) -> Trial:
    return Trial(
        method=method,
        policy="p",
        protocol="appl",
        world=world,
        course="",
        trial=number,
        seed=1,
        success=success,
        time_s=time_s,
        outcome="goal" if success else "timeout",
        collisions=0,
        distance_m=6.0,
        min_clearance_m=0.1,
        recoveries=0,
        decisions=2,
        digest="0" * 16,
        parameters="0.5 1.57 6 20 0.1 0.75 1 0.3;",
    )


@dataclass(frozen=True)
class ReadEnvironment:
    """A runner whose jobs are names of environment variables."""

    def __call__(self) -> ReadEnvironment.Runner:
        return ReadEnvironment.Runner()

    class Runner:
        def __call__(self, name: str) -> tuple[str, str]:
            return name, os.environ.get(name, "")
