"""How much is there to gain: from tuning parameters once, and from adapting them to the world?

For each timing preset, mean traversal time on test worlds (protocol `appl`: a failure counts 70 s) of
  default   the hand-tuned parameters of the robot's maker
  fixed     the best of N random sets, found on the training worlds by successive halving
  adapted   the best set for each test world, chosen by successive halving in that world
All three are measured with seeds that no choice has seen, so choosing by luck gains nothing. `adapted` is
what a context predictor could reach that knows the world and keeps one set: a learned policy may do better,
since it changes sets within a world, or worse.

    python benchmarks/headroom.py --worlds PATH_OF_BARN_WORLDS --timings gazebo ideal --folder runs/headroom

Interrupted, the same command goes on where it stopped. Prints a table; writes headroom.json, whose
`fixed.policy` is what `appl-dist evaluate` and `load_policy` take.
"""

from __future__ import annotations

import argparse
import json
import logging
import os
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console
from rich.table import Table

from appl_dist.actor.protocol import PROTOCOLS
from appl_dist.actor.world_split import select_worlds
from appl_dist.config import load
from appl_dist.errors import UserError
from appl_dist.evaluate.progress import show_progress
from appl_dist.evaluate.runner import NavigationRunner, make_methods
from appl_dist.evaluate.statistics import collect, compare, summarise
from appl_dist.evaluate.trial_log import TrialLog
from appl_dist.evaluate.trials import Job, Method, Trial, run_jobs, trial_seed
from appl_dist.files import write_atomic
from appl_dist.planner.dwa import DWA

TIMINGS = ("gazebo", "robot", "ideal")
# Trial numbers of the three stages, hence their seeds, never meet.
TUNE, CHOOSE, MEASURE = 0, 10_000, 20_000

Runs = Callable[[Sequence[tuple[str, int, int]]], list[Trial]]  # (label, world, trial number) to trials


def main() -> int:
    options = _options()
    logging.basicConfig(level=logging.INFO, format="%(message)s")
    results: dict[str, Any] = {}
    try:
        for name in options.timings:
            results[name] = measure(name, options)
            text = json.dumps({"command": sys.argv, "timings": results}, indent=1)
            write_atomic(Path(options.folder) / "headroom.json", text + "\n")
    except UserError as error:
        print(f"headroom: {error}", file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        print("stopped; the same command goes on from here", file=sys.stderr)
        return 130
    Console().print(table(results))
    return 0


def measure(timing: str, options: argparse.Namespace) -> dict[str, Any]:
    """The three stages for one timing preset."""
    rng = np.random.default_rng(options.seed)
    train = select_worlds(options.worlds, options.world_count, 0, options.train)
    test = select_worlds(options.worlds, options.world_count, 0, options.test)
    both = {w.index for w in train} & {w.index for w in test}
    if both:
        raise UserError(f"--test: world {min(both)} also trains; give worlds that --train does not")
    test = test[:: max(1, len(test) // options.test_count)][: options.test_count]
    methods = {m.label: m for m in make_methods(list(candidates(options.sets, rng).items()))}
    protocol = PROTOCOLS.get("appl")
    # `ideal` is the loop of the reference episodes, whose robot did exactly what it was told.
    overrides = [f"timing={timing}", "planner.arithmetic=fast", *(["robot.drive=ideal"] if timing == "ideal" else [])]
    settings = load(overrides)
    parts = {"timing": settings.timing, "robot": settings.robot, "planner": settings.planner}
    worlds = tuple({w.index: w for w in train + test}.values())
    make_runner = NavigationRunner(worlds, tuple(methods.values()), {"protocol": protocol} | parts)
    path = Path(options.folder) / f"trials-{timing}.csv"
    with TrialLog(path, Trial, protocol.name, make_runner.config_hash()) as log:

        def run(wanted: Sequence[tuple[str, int, int]], title: str) -> list[Trial]:
            jobs = [_job(methods[label], w, k, options.seed) for label, w, k in wanted]
            with show_progress(len(jobs), f"{timing}: {title}", done=len(log.matching(jobs))) as on_trial:
                return run_jobs(jobs, make_runner, workers=options.workers, log=log, on_trial=on_trial)

        failed_s = protocol.failed_time_s
        order = [int(w) for w in rng.permutation([w.index for w in train])]
        fixed = tune_once(list(methods), order, lambda j: run(j, "tune once"), failed_s, options.first_trials)
        indices = [w.index for w in test]
        chosen = choose_each(
            list(methods), indices, lambda j: run(j, "choose per world"), failed_s, options.choose_trials
        )
        numbers = range(MEASURE, MEASURE + options.trials)
        pick: dict[str, Mapping[int, str]] = {
            "default": dict.fromkeys(indices, "default"),
            "fixed": dict.fromkeys(indices, fixed),
            "adapted": chosen,
        }
        wanted = {(by_world[w], w, k) for by_world in pick.values() for w in indices for k in numbers}
        trials = {t.key: t for t in run(sorted(wanted), "measure")}
    samples = {
        name: collect((trials[by_world[w], w, k] for w in indices for k in numbers), failed_s)
        for name, by_world in pick.items()
    }
    merged = {name: _one(by_method) for name, by_method in samples.items()}
    rows = {}
    for name in pick:
        summary = summarise(name, merged[name], indices)
        gains = {
            f"versus_{other}": _gain(compare(name, other, merged, indices, rng=np.random.default_rng(0)))
            for other in pick
            if other != name
        }
        rows[name] = asdict(summary) | gains
    rows["fixed"]["policy"] = methods[fixed].spec
    rows["adapted"]["policies"] = {w: methods[label].spec for w, label in chosen.items()}
    rows["adapted"]["distinct"] = len(set(chosen.values()))
    return rows


def candidates(count: int, rng: np.random.Generator) -> dict[str, str]:
    """`count` policies by label: default, default made fast, and sets drawn evenly from the box."""
    result = {"default": "default", "fast": "set:max_vel_x=2,vx_samples=12"}
    for i in range(count - len(result)):
        values = DWA.to_values(rng.uniform(-1.0, 1.0, len(DWA)))
        result[f"set-{i:03d}"] = "set:" + ",".join(
            f"{name}={value:.4g}" for name, value in zip(DWA.names, values, strict=True)
        )
    return result


def tune_once(labels: list[str], worlds: list[int], run: Runs, failed_s: float, first: int) -> str:
    """The best label over `worlds` (in random order), by successive halving from `first` trials each."""
    sequence = [(w, TUNE + k) for k in range(100) for w in worlds]
    alive, n = labels, first
    while len(alive) > 1:
        trials = run([(label, w, k) for w, k in sequence[:n] for label in alive])
        alive = _best(alive, trials, failed_s, (len(alive) + 1) // 2)
        n *= 2
    return alive[0]


def choose_each(
    labels: list[str], worlds: list[int], run: Runs, failed_s: float, budgets: Sequence[int]
) -> dict[int, str]:
    """The best label for each world by itself; a quarter is kept after each of `budgets` trials a set."""
    alive = dict.fromkeys(worlds, labels)
    for n in budgets:
        trials = run([(label, w, CHOOSE + k) for k in range(n) for w in worlds for label in alive[w]])
        for w in worlds:
            here = [t for t in trials if t.world == w]
            keep = 1 if n == budgets[-1] else max(2, len(alive[w]) // 4)
            alive[w] = _best(alive[w], here, failed_s, keep)
    return {w: alive[w][0] for w in worlds}


def table(results: Mapping[str, Mapping[str, Any]]) -> Table:
    view = Table(title="Mean traversal time on test worlds, protocol appl (a failure counts 70 s)")
    for heading in ("timing", "parameters", "time, s", "success", "gain over default", "gain over fixed"):
        view.add_column(heading, justify="left" if heading in ("timing", "parameters") else "right")
    for timing, rows in results.items():
        for name, row in rows.items():
            view.add_row(
                timing,
                name,
                f"{row['mean_time_s']:.2f}",
                f"{row['success']:.1%}",
                _cell(row.get("versus_default")),
                _cell(row.get("versus_fixed")) if name == "adapted" else "",
            )
    return view


def _cell(gain: Mapping[str, float] | None) -> str:
    if gain is None:
        return ""
    return f"{gain['percent']:.1f} % ({gain['low_s']:+.2f} to {gain['high_s']:+.2f} s)"


def _gain(c: Any) -> dict[str, float]:
    return {
        "gain_s": c.improvement_s,
        "low_s": c.improvement_low_s,
        "high_s": c.improvement_high_s,
        "percent": c.improvement_percent,
        "worlds_better": c.better,
        "worlds_worse": c.worse,
    }


def _best(labels: list[str], trials: Sequence[Trial], failed_s: float, keep: int) -> list[str]:
    """The `keep` labels of least mean counted time; ties go to the earlier label."""
    times: dict[str, list[float]] = {label: [] for label in labels}
    for t in trials:
        times[t.method].append(t.time_s if t.success else failed_s)
    return sorted(labels, key=lambda label: float(np.mean(times[label])))[:keep]


def _one(by_method: Mapping[str, Any]) -> Any:
    """Samples of several labels, each in worlds of its own, as those of one method."""
    parts = list(by_method.values())
    return type(parts[0])(
        times_s={w: v for p in parts for w, v in p.times_s.items()},
        trials={w: v for p in parts for w, v in p.trials.items()},
        rows={w: v for p in parts for w, v in p.rows.items()},
        successes={w: v for p in parts for w, v in p.successes.items()},
    )


def _job(method: Method, world: int, trial: int, seed: int) -> Job:
    return Job(method.label, method.fingerprint, world, trial, trial_seed(seed, world, trial))


def _options() -> argparse.Namespace:
    parser = argparse.ArgumentParser(
        description=(__doc__ or "").split("\n", 1)[0], formatter_class=argparse.ArgumentDefaultsHelpFormatter
    )
    parser.add_argument("--worlds", default="", help="BARN worlds (folder, tarball or npz); empty: generated ones")
    parser.add_argument("--world-count", type=int, default=300, help="how many to generate")
    parser.add_argument("--train", default="train", help="worlds to tune on")
    parser.add_argument("--test", default="test", help="worlds to report on")
    parser.add_argument("--test-count", type=int, default=20, help="how many of these, evenly spread")
    parser.add_argument("--timings", nargs="+", default=["gazebo", "ideal"], choices=TIMINGS)
    parser.add_argument("--sets", type=int, default=32, help="parameter sets tried, default and fast included")
    parser.add_argument("--first-trials", type=int, default=8, help="trials a set before the first halving")
    parser.add_argument("--choose-trials", type=int, nargs="+", default=[2, 6], help="trials a set, per world")
    parser.add_argument("--trials", type=int, default=8, help="fresh trials a world to report")
    parser.add_argument("--workers", type=int, default=len(os.sched_getaffinity(0)))
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--folder", default="runs/headroom")
    options = parser.parse_args()
    if (
        options.test_count < 1
        or options.sets < 2
        or options.trials < 2
        or options.first_trials < 1
        or min(options.choose_trials) < 1
    ):
        parser.error("--sets, --trials: at least 2; --test-count, --first-trials, --choose-trials: at least 1")
    return options


if __name__ == "__main__":
    sys.exit(main())
