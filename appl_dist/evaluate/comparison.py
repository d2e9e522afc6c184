"""An evaluation from policies and worlds to trials and their numbers.

Writes into its folder: evaluation.json, worlds.csv, trials.csv (as trials finish) and summary.json. The same call on
the same folder goes on where it stopped; more methods, worlds or trials add to what is there.
"""

from __future__ import annotations

import json
import logging
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from rich.console import Console

from appl_dist.actor.protocol import PROTOCOLS, Protocol
from appl_dist.errors import UserError
from appl_dist.evaluate import provenance
from appl_dist.evaluate.analysis import Analysis, analyse, as_dict
from appl_dist.evaluate.folder import Head, course_facts, save_head, write_head
from appl_dist.evaluate.progress import show_progress
from appl_dist.evaluate.runner import NavigationRunner, make_methods
from appl_dist.evaluate.trial_log import TrialLog
from appl_dist.evaluate.trials import TRIALS_FILE, Trial, make_jobs, run_jobs
from appl_dist.evaluate.workers import Crew
from appl_dist.files import write_atomic
from appl_dist.sim.worlds import World

log = logging.getLogger(__name__)

SUMMARY_FILE = "summary.json"


@dataclass(frozen=True)
class EvaluationResult:
    """session: the trials run this time, seconds, episodes_per_s and x_real_time, or {} where all were there."""

    folder: Path
    trials: tuple[Trial, ...]
    analysis: Analysis
    session: Mapping[str, Any]


def evaluate(
    methods: Sequence[tuple[str, str]],
    worlds: Sequence[World],
    trials_per_world: int,
    folder: str | Path,
    *,
    protocol: str | Protocol = "appl",
    environment: Mapping[str, Any] | None = None,
    groups: Mapping[str, Sequence[int]] | None = None,
    workers: int | Crew = 1,
    seed: int = 0,
    settings: Mapping[str, Any] | None = None,
    console: Console | None = None,
) -> EvaluationResult:
    """Run every method in every world and analyse what came of it.

    methods: (label, policy specification); the labels "default" and "fixed" mark the baselines every
    table compares with. environment: further arguments of `NavigationEnv` (timing, planner …). groups:
    world indices by name of the group reported together (all: one group). workers: processes, 0 for
    none, or a crew elsewhere. settings: the configuration this comes from, kept for replays. Raises UserError.
    """
    if trials_per_world < 1:
        raise UserError(f"trials: got {trials_per_world}; allowed 1 or more a world")
    if isinstance(workers, int) and workers < 0:
        raise UserError(f"workers: got {workers}; allowed 0 (in this process) or more")
    rules = _protocol(protocol)
    given = environment or {}
    checked = make_methods(methods, given)
    chosen = _groups(groups, worlds)
    indices = sorted({w for group in chosen.values() for w in group})
    runner = NavigationRunner(tuple(worlds), checked, {**given, "protocol": rules})
    jobs = make_jobs(checked, indices, range(trials_per_world), seed, runner.courses())
    folder = Path(folder)
    head = Head(rules, checked, {n: tuple(g) for n, g in chosen.items()}, seed, trials_per_world, settings or {})
    with TrialLog(folder / TRIALS_FILE, Trial, rules.name, runner.config_hash()) as trial_log:
        old = len(trial_log.matching(jobs))
        head = write_head(folder, head, [course_facts(w, rules) for w in worlds if w.index in set(indices)])
        if old:
            log.info("%s: %d of %d trials are there already", folder, old, len(jobs))
        session: dict[str, Any] = {}
        if old < len(jobs):
            session = _begin()
            head = replace(head, sessions=(*head.sessions, session))
            save_head(folder, head)  # before the first trial: a killed evaluation, too, says where it ran
        driven: list[Trial] = []
        started = time.monotonic()
        try:
            with show_progress(len(jobs), "evaluate", console, done=old) as on_trial:

                def note(trial: Trial) -> None:
                    driven.append(trial)
                    on_trial(trial)

                trials = run_jobs(jobs, runner, workers=workers, log=trial_log, on_trial=note)
        finally:
            if session:
                count = max(1, workers) if isinstance(workers, int) else len(workers)
                session |= {"workers": count, **_speed(driven, time.monotonic() - started)}
                save_head(folder, head)
    labels = [m.label for m in checked]
    analysis = analyse(trials, labels, chosen, limit_s=rules.limit_s, failed_time_s=rules.failed_time_s, seed=seed)
    write_atomic(folder / SUMMARY_FILE, json.dumps({"session": session, **as_dict(analysis)}, indent=1) + "\n")
    if session:
        (console or Console()).print(speed_line(session), highlight=False)
    return EvaluationResult(folder, tuple(trials), analysis, session)


def speed_line(session: Mapping[str, Any]) -> str:
    """How fast a session was, in words."""
    return (
        f"{session['trials']:,} trials in {session['seconds']:.0f} s on {session['workers']} processes: "
        f"{session['episodes_per_s']:.2f} episodes/s, {session['x_real_time']:.0f} times real time"
    )


def _begin() -> dict[str, Any]:
    return {
        "begun": datetime.now(UTC).isoformat(timespec="seconds"),
        "workers": 0,
        "machine": provenance.machine(),
        "code": provenance.code(),
        **_speed((), 1.0),
    }


def _speed(driven: Sequence[Trial], seconds: float) -> dict[str, Any]:
    return {
        "trials": len(driven),
        "seconds": seconds if driven else 0.0,
        "episodes_per_s": len(driven) / seconds,
        "x_real_time": sum(t.time_s for t in driven) / seconds,
    }


def _protocol(protocol: str | Protocol) -> Protocol:
    if isinstance(protocol, Protocol):
        return protocol
    return PROTOCOLS.get(protocol)


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
