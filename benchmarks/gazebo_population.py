"""Default DWA in this simulator beside the runs that were recorded in Gazebo.

Two populations were recorded by the authors of BARN:
  challenge    50 worlds x 10, BARN Challenge of 2022, stopped 0.5 m before the goal (`gazebo_dwa_challenge.csv`)
  ros_jackal   300 worlds x 20, the rules of ros_jackal (`gazebo_dwa_ros_jackal.csv`)
The same worlds are driven here under the same rules and compared: shares of outcomes, times, and whether the same
worlds, and the same of the twelve generation sets, are slow. Besides, the fast set "v2" (2 m/s, 12 x 20 samples)
against default DWA by the score of 2022, at 1 m: a simulator in which fast driving is too easy shows it there.

    python benchmarks/gazebo_population.py --worlds BARN --recorded RECORDED --runs 4 --folder runs/population
    python benchmarks/gazebo_population.py … --arithmetic exact fast      paired tests of the two arithmetics

Interrupted, the same command goes on where it stopped. Prints tables; draws population.png and .pdf in the folder.
"""

from __future__ import annotations

import argparse
import csv
import logging
import os
import sys
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rich.console import Console
from rich.table import Table
from scipy.stats import binomtest, false_discovery_control, spearmanr, ttest_1samp, ttest_rel, wilcoxon

from appl_dist.actor.protocol import PROTOCOLS, Protocol
from appl_dist.actor.timing import TimingSettings
from appl_dist.errors import UserError
from appl_dist.evaluate.breakdown import CLIPS, trial_scores
from appl_dist.evaluate.progress import show_progress
from appl_dist.evaluate.runner import NavigationRunner, course_of, make_methods
from appl_dist.evaluate.statistics import collect
from appl_dist.evaluate.trial_log import TrialLog
from appl_dist.evaluate.trials import Trial, make_jobs, run_jobs
from appl_dist.planner.planner_settings import Arithmetic, PlannerSettings
from appl_dist.sim.worlds import World, load_worlds

V2 = "set:max_vel_x=2,vx_samples=12"
FILES = {"challenge": "gazebo_dwa_challenge.csv", "ros_jackal": "gazebo_dwa_ros_jackal.csv"}
MEDIAN_S = {"challenge": 31.5, "ros_jackal": 24.6}  # over all recorded successes; the tables hold worlds only
Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Recorded:
    """One world's recorded runs: shares of outcomes and times of successes, nan where there was none."""

    runs: int
    success: float
    collision: float
    timeout: float
    mean_s: float
    median_s: float


def main() -> int:
    options = _options()
    logging.basicConfig(level=logging.INFO, format="%(message)s")
    try:
        worlds = load_worlds(options.worlds)
        drawn = {}
        for name in options.populations:
            recorded = read_recorded(Path(options.recorded) / FILES[name])
            driven = {}
            for arithmetic in options.arithmetic:
                drawn[f"{name}, {arithmetic}"], driven[arithmetic] = compare(
                    name, recorded, worlds, options, arithmetic
                )
            if len(driven) == 2:
                tell_apart(name, driven["exact"], driven["fast"])
        if options.scores:
            scores(worlds, options, options.arithmetic[0])
        draw(drawn, Path(options.folder))
    except UserError as error:
        print(f"gazebo_population: {error}", file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        print("stopped; the same command goes on from here", file=sys.stderr)
        return 130
    return 0


def read_recorded(file: Path) -> dict[int, Recorded]:
    """Recorded runs by world. Raises UserError."""
    try:
        with file.open(newline="") as text:
            rows = list(csv.DictReader(text))
        return {int(r["world"]): _recorded(r) for r in rows}
    except (OSError, KeyError, ValueError) as error:
        raise UserError(f"{file}: is no table of recorded runs ({error})") from None


def _recorded(row: dict[str, str]) -> Recorded:
    def number(*names: str) -> float:
        return next((float(row[n]) for n in names if row.get(n)), float("nan"))

    return Recorded(
        runs=int(number("runs", "trials")),
        success=number("success_rate"),
        collision=number("collision_rate"),
        timeout=number("timeout_rate"),
        mean_s=number("mean_time_success_s", "mean_time"),
        median_s=number("median_time_success_s"),
    )


def drive(
    name: str,
    protocol: Protocol,
    methods: Sequence[tuple[str, str]],
    worlds: Sequence[World],
    options: Any,
    arithmetic: Arithmetic,
) -> list[Trial]:
    """The trials of `methods` in `worlds`, kept in a file of the folder."""
    chosen = make_methods(methods)
    environment = {"protocol": protocol, "timing": TimingSettings(), "planner": PlannerSettings(arithmetic=arithmetic)}
    make_runner = NavigationRunner(tuple(worlds), chosen, environment)
    courses = {w.index: course_of(w) for w in worlds}
    jobs = make_jobs(chosen, [w.index for w in worlds], range(options.runs), options.seed, courses)
    path = Path(options.folder) / f"trials-{name}-{arithmetic}.csv"
    path.parent.mkdir(parents=True, exist_ok=True)
    with (
        TrialLog(path, Trial, protocol.name, make_runner.config_hash()) as log,
        show_progress(len(jobs), name, done=len(log.matching(jobs))) as on_trial,
    ):
        return run_jobs(jobs, make_runner, workers=options.workers, log=log, on_trial=on_trial)


def compare(
    name: str, recorded: dict[int, Recorded], worlds: Sequence[World], options: Any, arithmetic: Arithmetic
) -> tuple[tuple[Floats, Floats], list[Trial]]:
    """Print one population beside its record; returns times per world (recorded, ours; failures 100 s), and trials."""
    protocol = PROTOCOLS.get("challenge_2022" if name == "challenge" else name)
    worlds = [w for w in worlds if w.index in recorded][:: options.every]
    trials = drive(name, protocol, [("default", "default")], worlds, options, arithmetic)
    by_world = {w.index: [t for t in trials if t.world == w.index] for w in worlds}
    rows = [recorded[w.index] for w in worlds]
    weights = np.array([r.runs * r.success for r in rows])
    means = np.nan_to_num(np.array([r.mean_s for r in rows]))
    times = np.array([t.time_s for t in trials if t.success])
    theirs = np.array([m * r.success + 100.0 * (1.0 - r.success) for m, r in zip(means, rows, strict=True)])
    ours = np.array([np.mean([t.time_s if t.success else 100.0 for t in by_world[w.index]]) for w in worlds])
    table = Table(title=f"default DWA, {name}: {len(worlds)} worlds x {options.runs}, {arithmetic} arithmetic")
    for column in ("", "recorded", "here", "allowed"):
        table.add_column(column, justify="right" if column else "left")
    ends = {o: float(np.mean([t.outcome == o for t in trials])) for o in ("goal", "collision", "timeout")}
    narrow = name == "challenge"

    def record(what: str) -> float:
        return float(np.mean([getattr(r, what) for r in rows]))

    table.add_row("success", f"{record('success'):.3f}", f"{ends['goal']:.3f}", "±.05" if narrow else "±.03")
    if narrow:
        table.add_row("collision", f"{record('collision'):.3f}", f"{ends['collision']:.3f}", ".02 to .08")
        table.add_row("time-out", f"{record('timeout'):.3f}", f"{ends['timeout']:.3f}", ".06 to .13")
    else:
        touched = float(np.mean([t.collided for t in trials]))
        table.add_row("touched an obstacle", "", f"{touched:.3f}", "")
    mean_s = float((means * weights).sum() / weights.sum())
    error_s = float(times.std() / np.sqrt(len(times)))
    table.add_row(
        "mean time of successes, s",
        f"{mean_s:.1f}",
        f"{times.mean():.1f} ± {error_s:.1f}",
        "±2.5" if narrow else "±10 %",
    )
    table.add_row("median time of successes, s", f"{MEDIAN_S[name]:.1f}", f"{np.median(times):.1f}", "±10 %")
    table.add_row("rank correlation over worlds", "", f"{spearmanr(theirs, ours)[0]:.2f}", "≥ .7" if narrow else "")
    if not narrow:
        sets = np.array([w.set_index for w in worlds])
        a, b = (np.array([x[sets == s].mean() for s in np.unique(sets)]) for x in (theirs, ours))
        table.add_row("rank correlation over generation sets", "", f"{spearmanr(a, b)[0]:.2f}", "≥ .9")
    Console().print(table)
    return (theirs, ours), trials


def tell_apart(name: str, exact: Sequence[Trial], fast: Sequence[Trial]) -> None:
    """Print what paired tests see between two arithmetics: the same worlds and seeds, failures counted 100 s."""
    a, b = ({(t.world, t.trial): t for t in trials} for trials in (exact, fast))
    pairs = sorted(a.keys() & b.keys())
    seconds = np.array([[t.time_s if t.success else 100.0 for t in (a[k], b[k])] for k in pairs])
    difference = seconds[:, 1] - seconds[:, 0]
    worlds = np.array([world for world, _ in pairs])
    means = np.array([difference[worlds == w].mean() for w in np.unique(worlds)])
    lost = sum(a[k].success and not b[k].success for k in pairs)
    won = sum(b[k].success and not a[k].success for k in pairs)
    p_worlds = [ttest_rel(*seconds[worlds == w].T).pvalue for w in np.unique(worlds) if (worlds == w).sum() > 1]
    real = np.array([p for p in p_worlds if not np.isnan(p)])
    below = int((false_discovery_control(real) < 0.05).sum()) if len(real) else 0
    same = sum(a[k].digest == b[k].digest for k in pairs)
    test = ttest_1samp(means, 0.0)
    low, high = test.confidence_interval(0.95)
    print(
        f"{name}, fast less exact, {len(pairs)} pairs of one world and seed in {len(means)} worlds:\n"
        f"  {same} pairs the same to the bit; mean difference {means.mean():+.2f} s, 95 % interval {low:+.2f} to "
        f"{high:+.2f}, p = {test.pvalue:.2f} (t), {wilcoxon(means).pvalue:.2f} (signed ranks)\n"
        f"  success in {lost} pairs only with exact, in {won} only with fast, p = "
        f"{binomtest(won, max(1, won + lost)).pvalue:.2f} (McNemar)\n"
        f"  worlds that differ at a false discovery rate of 5 %: {below} of {len(real)}"
    )


def scores(worlds: Sequence[World], options: Any, arithmetic: Arithmetic) -> None:
    """Score of 2022 (clip at 4 and 8 optimal times) at 1 m: default DWA and v2 on every sixth world."""
    protocol = replace(PROTOCOLS.get("challenge_2022"), goal_radius_m=1.0)
    worlds = [w for w in worlds if w.index % 6 == 0][:: options.every]
    trials = drive("scores", protocol, [("default", "default"), ("v2", V2)], worlds, options, arithmetic)
    samples = collect(trials, protocol.failed_time_s)
    low, high = CLIPS["before 2024"]
    table = Table(title=f"score of 2022 at 1 m: {len(worlds)} worlds x {options.runs}")
    for column in ("", "score", "against default", "success", "mean time of successes, s"):
        table.add_column(column, justify="right" if column else "left")
    points = {
        label: np.mean([trial_scores(s, w.index, protocol.optimal_time_s(w), low, high) for w in worlds])
        for label, s in samples.items()
    }
    for label in ("default", "v2"):
        mine = [t for t in trials if t.method == label]
        times = [t.time_s for t in mine if t.success]
        table.add_row(
            label,
            f"{points[label]:.3f}",
            f"{points[label] / points['default']:.2f}",
            f"{np.mean([t.success for t in mine]):.2f}",
            f"{np.mean(times):.1f}",
        )
    Console().print(table)


def draw(drawn: dict[str, tuple[Floats, Floats]], folder: Path) -> None:
    """Times per world, recorded against here, and their distributions."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    if not drawn:
        return
    figure, axes = plt.subplots(len(drawn), 2, figsize=(9.0, 4.0 * len(drawn)), squeeze=False, layout="constrained")
    for (left, right), (name, (theirs, ours)) in zip(axes, drawn.items(), strict=True):
        left.plot([0, 100], [0, 100], color="0.7", linewidth=1)
        left.plot(theirs, ours, ".", color="#0072B2", alpha=0.6)
        left.set(
            xlabel="recorded, s", ylabel="here, s", title=f"{name}: mean time by world, failures 100 s", aspect="equal"
        )
        for values, label, colour in ((theirs, "recorded", "#D55E00"), (ours, "here", "#0072B2")):
            right.ecdf(values, label=label, color=colour)
        right.set(xlabel="mean time of a world, s", ylabel="share of worlds", title=name)
        right.legend(frameon=False)
    for suffix in ("png", "pdf"):
        figure.savefig(folder / f"population.{suffix}", dpi=120)
    plt.close(figure)


def _options() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--worlds", required=True, help="folder of the real BARN worlds")
    parser.add_argument("--recorded", required=True, help="folder of the recorded tables")
    parser.add_argument("--populations", nargs="+", choices=FILES, default=list(FILES))
    parser.add_argument("--runs", type=int, default=10, help="runs of every world")
    parser.add_argument("--every", type=int, default=1, help="drive every n-th world only")
    parser.add_argument("--arithmetic", nargs="+", choices=["exact", "fast"], default=["exact"], help="both: compared")
    parser.add_argument("--scores", action="store_true", help="also default and v2 by the score of 2022")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--workers", type=int, default=os.cpu_count() or 1)
    parser.add_argument("--folder", default="runs/population")
    options = parser.parse_args()
    for name in ("runs", "every", "workers"):
        if getattr(options, name) < 1:
            parser.error(f"--{name}: got {getattr(options, name)}; allowed 1 or more")
    return options


if __name__ == "__main__":
    sys.exit(main())
