"""Trials: one drive of one method through one world, and running many of them in parallel.

In: methods, world indices, trials a world, a factory of runners. Out: a sorted list of `Trial`, and, if
asked for, a `trials.csv` that grows as trials finish and from which an interrupted evaluation goes on.

Common random numbers: trial k of a world has the same seed for every method, so methods meet the same
sensor noise and timing. What a trial gives depends on its job alone, never on the number of workers.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from appl_dist.evaluate.trial_log import TrialLog
from appl_dist.evaluate.workers import Crew, run_parallel

TRIALS_FILE = "trials.csv"
OUTCOMES = ("goal", "timeout", "collision", "rollover")


@dataclass(frozen=True)
class Method:
    """A policy under test: the label of its rows, the specification that `load_policy` takes, and a
    fingerprint of its content, so that trials of an older policy of the same name are not mixed in."""

    label: str
    spec: str
    fingerprint: str = ""

    def __post_init__(self) -> None:
        if not self.fingerprint:
            object.__setattr__(self, "fingerprint", hashlib.sha256(self.spec.encode()).hexdigest()[:12])


@dataclass(frozen=True)
class Job:
    """What identifies a trial before it has run."""

    method: str
    policy: str  # fingerprint of the method's policy
    world: int
    trial: int
    seed: int
    course: str = ""  # fingerprint of the world's geometry

    @property
    def key(self) -> tuple[str, int, int]:
        return self.method, self.world, self.trial


@dataclass(frozen=True)
class Trial:
    """The result of one trial; a row of `trials.csv`, from which it can be driven again, bit for bit.

    `time_s` is the simulated time driven, also for a failed trial: what a failure counts is the
    protocol's business (`failed_time_s`) and enters in the statistics. `outcome` is one of OUTCOMES;
    `collisions` counts contacts with obstacles, which some protocols do not end a trial for.
    `digest` stands for every bit of the trajectory. `parameters` is the trace of the planner parameters in
    force: decisions separated by ";", values by " ", an empty decision repeats the one before it.
    """

    method: str
    policy: str
    protocol: str
    world: int
    course: str
    trial: int
    seed: int
    success: bool
    time_s: float
    outcome: str
    collisions: int
    distance_m: float
    min_clearance_m: float
    recoveries: int
    decisions: int
    digest: str
    parameters: str

    def __post_init__(self) -> None:
        if self.outcome not in OUTCOMES:
            raise ValueError(f"outcome: got {self.outcome!r}; allowed {', '.join(OUTCOMES)}")
        if self.success != (self.outcome == "goal"):
            raise ValueError(f"success: got {self.success} with outcome {self.outcome!r}")
        if not np.isfinite(self.time_s) or self.time_s < 0.0:
            raise ValueError(f"time_s: got {self.time_s}; allowed a finite time, 0 or more")

    @property
    def key(self) -> tuple[str, int, int]:
        return self.method, self.world, self.trial

    @property
    def collided(self) -> bool:
        return self.collisions > 0


def encode_trace(values: NDArray[np.float64]) -> str:
    """Parameter values (decisions, n) as a cell of text; every float reads back to the same bits."""
    rows = [" ".join(str(int(v)) if v.is_integer() else repr(v) for v in row) for row in values.tolist()]
    return ";".join("" if i and row == rows[i - 1] else row for i, row in enumerate(rows))


def decode_trace(text: str) -> NDArray[np.float64]:
    """(decisions, n) values of `encode_trace`. ValueError if it is none."""
    rows: list[list[float]] = []
    for row in text.split(";"):
        rows.append([float(v) for v in row.split(" ")] if row or not rows else rows[-1])
    return np.array(rows)


class Runner(Protocol):
    """Runs jobs; lives in one worker process and keeps its simulator between them."""

    def __call__(self, job: Job) -> Trial: ...


def trial_seed(seed: int, world: int, trial: int) -> int:
    """Seed of a trial, the same for every method; below 2^53, so any reader of the CSV keeps it exact."""
    return int(np.random.SeedSequence([seed, world, trial]).generate_state(1, np.uint64)[0] >> np.uint64(11))


def make_jobs(
    methods: Sequence[Method],
    worlds: Sequence[int],
    trials: Iterable[int],
    seed: int,
    courses: Mapping[int, str] | None = None,
) -> list[Job]:
    """Every method in every world for each trial index. courses: fingerprints of the worlds' geometry.

    Trial index outermost and methods innermost: an interrupted evaluation has about equally many
    trials of every method in every world.
    """
    return [
        Job(m.label, m.fingerprint, world, k, trial_seed(seed, world, k), (courses or {}).get(world, ""))
        for k in trials
        for world in worlds
        for m in methods
    ]


def run_jobs(
    jobs: Sequence[Job],
    make_runner: Callable[[], Runner],
    *,
    workers: int | Crew = 1,
    log: TrialLog | None = None,
    on_trial: Callable[[Trial], None] | None = None,
) -> list[Trial]:
    """Run the jobs that `log` does not hold yet; return the trials of all, in the order of `jobs`.

    `make_runner` is called once in each of `workers` spawned processes (0: in this process), so it must
    pickle; or `workers` is a crew of another kind. `on_trial` is called in this process for each trial that
    is run, in order of completion. Raises UserError for bad input or a full disk, RuntimeError with the
    worker's traceback for a fault in a runner; whatever ends it, the log holds every finished trial and no
    worker is left.
    """
    done: dict[tuple[str, int, int], Trial] = {}
    if log is not None:
        logged = log.matching(jobs)
        done = {job.key: logged[job.key] for job in jobs if job.key in logged}
    todo = [job for job in jobs if job.key not in done]
    crew = run_parallel(todo, make_runner, workers) if isinstance(workers, int) else workers(todo, make_runner)
    with closing(crew) as results:
        for trial in results:
            done[trial.key] = trial
            if log is not None:
                log.append(trial)
            if on_trial is not None:
                on_trial(trial)
    return [done[job.key] for job in jobs]


def run_trials(
    methods: Sequence[Method],
    worlds: Sequence[int],
    trials_per_world: int,
    make_runner: Callable[[], Runner],
    *,
    workers: int = 1,
    seed: int = 0,
    folder: str | Path | None = None,
    protocol: str = "",
    config_hash: str = "",
    courses: Mapping[int, str] | None = None,
    on_trial: Callable[[Trial], None] | None = None,
) -> list[Trial]:
    """`run_jobs` over methods × worlds × trials, logged to `folder`/trials.csv if a folder is given.

    `config_hash` stands for all that trials depend on besides method, world, trial, seed and policy (protocol,
    environment); a folder with another one, or of another protocol, is refused.
    """
    jobs = make_jobs(methods, worlds, range(trials_per_world), seed, courses)
    if folder is None:
        return run_jobs(jobs, make_runner, workers=workers, on_trial=on_trial)
    with TrialLog(Path(folder) / TRIALS_FILE, Trial, protocol, config_hash) as log:
        return run_jobs(jobs, make_runner, workers=workers, log=log, on_trial=on_trial)
