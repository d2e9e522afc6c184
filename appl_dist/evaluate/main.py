"""An evaluation from policies and worlds to tables and figures.

Writes into its folder: trials.csv (as trials finish), summary.json, table_mean and table_wins (.md and
.csv), figures (.png and .pdf). The same call on the same folder goes on where it stopped.
"""

from __future__ import annotations

import json
import logging
import re
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from rich.console import Console

from appl_dist.actor.protocol import PROTOCOLS, Protocol
from appl_dist.errors import UserError
from appl_dist.evaluate.analysis import Analysis, analyse, as_dict
from appl_dist.evaluate.progress import show_progress
from appl_dist.evaluate.runner import NavigationRunner, make_methods
from appl_dist.evaluate.tables import mean_table, wins_table
from appl_dist.evaluate.trials import Trial, run_trials
from appl_dist.files import write_atomic
from appl_dist.sim.worlds import World

log = logging.getLogger(__name__)

SUMMARY_VERSION = 1


@dataclass(frozen=True)
class EvaluationResult:
    folder: Path
    trials: tuple[Trial, ...]
    analysis: Analysis


def evaluate(
    methods: Sequence[tuple[str, str]],
    worlds: Sequence[World],
    trials_per_world: int,
    folder: str | Path,
    *,
    protocol: str | Protocol = "appl",
    environment: Mapping[str, Any] | None = None,
    groups: Mapping[str, Sequence[int]] | None = None,
    workers: int = 1,
    seed: int = 0,
    metrics: str | Path | None = None,
    console: Console | None = None,
) -> EvaluationResult:
    """Run every method in every world, print the tables, write the results.

    methods: (label, policy specification); the labels "default" and "fixed" mark the baselines every
    table compares with. environment: further arguments of `NavigationEnv` (timing, planner …). groups:
    world indices by name of the group reported together (all: one group). workers: processes, 0 for
    none. metrics: metrics.jsonl of a training run, for the learning curve. Raises UserError.
    """
    if trials_per_world < 1:
        raise UserError(f"trials: got {trials_per_world}; allowed 1 or more a world")
    rules = _protocol(protocol)
    checked = make_methods(methods, (environment or {}).get("space"))
    chosen = _groups(groups, worlds)
    runner = NavigationRunner(tuple(worlds), checked, {**(environment or {}), "protocol": rules})
    indices = sorted({w for group in chosen.values() for w in group})
    total = len(checked) * len(indices) * trials_per_world
    folder = Path(folder)
    with show_progress(total, "evaluate", console) as on_trial:
        trials = run_trials(
            checked,
            indices,
            trials_per_world,
            runner,
            workers=workers,
            seed=seed,
            folder=folder,
            config_hash=runner.config_hash(seed),
            on_trial=on_trial,
        )
    labels = [m.label for m in checked]
    analysis = analyse(trials, labels, chosen, limit_s=rules.limit_s, failed_time_s=rules.failed_time_s, seed=seed)
    summary = {
        "version": SUMMARY_VERSION,
        "protocol": asdict(rules),
        "seed": seed,
        "trials_per_world": trials_per_world,
        "config": runner.config_hash(seed),
        "methods": [asdict(m) for m in checked],
    }
    write_results(folder, analysis, summary, metrics)
    _print(analysis, folder, console or Console())
    return EvaluationResult(folder, tuple(trials), analysis)


def write_results(
    folder: Path, analysis: Analysis, summary: Mapping[str, Any], metrics: str | Path | None = None
) -> None:
    """summary.json, both tables and all figures of an analysis, each written whole."""
    write_atomic(folder / "summary.json", json.dumps({**summary, **as_dict(analysis)}, indent=1) + "\n")
    for name, table in (("table_mean", mean_table(analysis)), ("table_wins", wins_table(analysis))):
        write_atomic(folder / f"{name}.md", table.markdown())
        write_atomic(folder / f"{name}.csv", table.csv())
    _write_figures(folder / "figures", analysis, metrics)


def _write_figures(folder: Path, analysis: Analysis, metrics: str | Path | None) -> None:
    try:
        from appl_dist.evaluate import figures

        figure = figures.ecdf_figure(analysis)
    except ImportError:
        log.warning("no figures: matplotlib is not installed (pip install 'appl-dist[evaluate]')")
        return
    figures.save_figure(figure, folder / "times")
    for base in analysis.baselines:
        for method in analysis.methods:
            if method != base and (base, method) != ("fixed", "default"):
                name = f"difference_{_slug(method)}_{_slug(base)}"
                figures.save_figure(figures.difference_figure(analysis, method, base), folder / name)
    if metrics is not None:
        curve = figures.read_metrics(metrics)
        group = next((g for g in analysis.groups if g.name == "train"), analysis.groups[0])
        lines = {m: (group.summaries[m].mean_time_s, group.summaries[m].success) for m in analysis.baselines}
        figures.save_figure(figures.learning_figure(*curve, lines), folder / "learning")


def _print(analysis: Analysis, folder: Path, console: Console) -> None:
    console.print(mean_table(analysis).rich())
    if len(analysis.methods) > 1:
        console.print(wins_table(analysis).rich())
    console.print(f"trials, tables and figures in {folder}", highlight=False)


def _protocol(protocol: str | Protocol) -> Protocol:
    if isinstance(protocol, Protocol):
        return protocol
    if protocol not in PROTOCOLS:
        raise UserError(f"protocol: got {protocol!r}; allowed {', '.join(PROTOCOLS)}")
    return PROTOCOLS[protocol]


def _groups(groups: Mapping[str, Sequence[int]] | None, worlds: Sequence[World]) -> dict[str, list[int]]:
    known = {w.index for w in worlds}
    chosen = {name: list(dict.fromkeys(g)) for name, g in (groups or {"all": sorted(known)}).items() if len(g)}
    for name, indices in chosen.items():
        for index in indices:
            if index not in known:
                some = f"{min(known)}..{max(known)}" if known else "none"
                raise UserError(f"worlds: group {name!r} asks for world {index}; loaded are {len(known)}: {some}")
    if not chosen:
        raise UserError("worlds: got none; give at least one world to evaluate in")
    return chosen


def _slug(label: str) -> str:
    return re.sub(r"[^A-Za-z0-9.-]+", "_", label)
