"""Which pictures a report holds: figures of all trials, and some trials driven again for maps and films."""

from __future__ import annotations

import logging
import re
from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from appl_dist.errors import UserError
from appl_dist.evaluate.analysis import Analysis
from appl_dist.evaluate.folder import Evaluation
from appl_dist.evaluate.trial_replay import OpenEnv, Recording, replay, trial_name
from appl_dist.evaluate.trials import Trial
from appl_dist.report import figures, maps
from appl_dist.report.data import ReportData
from appl_dist.report.film import gif_bytes

if TYPE_CHECKING:
    from matplotlib.figure import Figure

log = logging.getLogger(__name__)

FRAME_MS = 100
FAILURES_SHOWN = 5
FILMS_SHOWN = 1  # of failures
EXAMPLES = (0.1, 0.5, 0.9)  # worlds that are shown: quantiles of the mean time over methods
METHODS_SHOWN = 4


@dataclass(frozen=True)
class Picture:
    """A figure under its file name; caption: what it shows."""

    name: str
    caption: str
    figure: Figure


@dataclass(frozen=True)
class Film:
    name: str
    caption: str
    gif: bytes


@dataclass(frozen=True)
class Replays:
    """Trials driven again: pictures, films, how many there were and what differed from the rows."""

    pictures: tuple[Picture, ...] = ()
    films: tuple[Film, ...] = ()
    count: int = 0
    differences: tuple[str, ...] = ()
    missing: str = ""  # why there are none


def statistics_pictures(data: ReportData) -> Iterator[Picture]:
    """Figures of all trials."""
    analysis = data.analysis
    groups = "; ".join(f"{g.name}: {len(g.worlds)} worlds" for g in analysis.groups)
    rules = f"protocol {analysis.protocol}, a failure counts {analysis.failed_time_s:g} s"
    for base in analysis.baselines or analysis.methods[:1]:
        for method in analysis.methods:
            if method != base and (base, method) != ("fixed", "default"):
                yield Picture(
                    f"difference_{slug(method)}_{slug(base)}",
                    f"Traversal time of {method} minus that of {base}, world by world, sorted; coloured where Welch's "
                    f"t-test finds p < 0.05 ({groups}; {rules}).",
                    figures.difference_figure(analysis, method, base),
                )
    yield Picture(
        "times_by_world", f"Mean traversal time of every world, with fits ({rules}).", figures.times_figure(analysis)
    )
    yield Picture(
        "times",
        "Share of trials at the goal by a time; where a curve ends is the success rate.",
        figures.ecdf_figure(analysis),
    )
    if len(analysis.methods) > 1:
        yield Picture(
            "profiles",
            "Performance profiles: share of worlds crossed within a factor of the world's fastest method.",
            figures.profile_figure(analysis),
        )
    for i, source in enumerate(s for s in data.sources if s.metrics is not None):
        picture = _learning(analysis, source.metrics, i)
        if picture:
            yield picture


def _learning(analysis: Analysis, metrics: object, number: int) -> Picture | None:
    try:
        curve = figures.read_metrics(str(metrics))
    except UserError as error:
        log.warning("no training curve: %s", error)
        return None
    group = next((g for g in analysis.groups if g.name == "train"), analysis.groups[0])
    lines = {m: (group.summaries[m].mean_time_s, group.summaries[m].success) for m in analysis.baselines}
    return Picture(
        "learning" if number == 0 else f"learning_{number + 1}",
        "Traversal time and success while training (running means over episodes, exploration noise included) against "
        f"the baselines on the {group.name} worlds.",
        figures.learning_figure(*curve, lines),
    )


def replay_pictures(data: ReportData, open_env: OpenEnv) -> Replays:
    """Drive examples and failures again. What cannot be replayed is told in `missing`, never raised."""
    examples, failures = _examples(data), _failures(data)
    subject = examples[-1]  # the last method in the hardest world shown
    wanted = list(dict.fromkeys([*examples, *failures]))
    found: dict[tuple[str, int, int], Recording] = {}
    try:
        by_folder: dict[str, list[tuple[str, int, int]]] = {}
        for key in wanted:
            by_folder.setdefault(str(data.origin[key][0].folder), []).append(key)
        for keys in by_folder.values():
            env = open_env(data.origin[keys[0]][0])
            try:
                for key in keys:
                    filmed = key == subject or key in failures[:FILMS_SHOWN]
                    found[key] = replay(env, data.origin[key][1], FRAME_MS if filmed else 0)
            finally:
                env.close()
    except UserError as error:
        return Replays(missing=str(error))
    pictures = [
        Picture(
            "paths_speed",
            "Ways through an easy, a middling and a difficult world, coloured by speed; circle: start, star: goal "
            "reached, cross: not reached.",
            maps.map_figure([found[k] for k in examples]),
        )
    ]
    names = found[subject].names
    ways = [found[k] for k in examples if found[k].names == names]
    moving = [r for r in ways if len(np.unique(r.result.parameters, axis=0)) > 1]
    if moving:
        ranges = [np.ptp(r.result.parameters, axis=0) / (r.high - r.low) for r in moving]
        name = names[int(np.argmax(np.sum(ranges, axis=0)))]
        pictures.append(
            Picture(
                f"paths_{name}",
                f"The same ways of policies that adapt, coloured by {name}, the parameter that varies most in them.",
                maps.map_figure(moving, name),
            )
        )
    shown = found[subject]
    middle = shown.frames[len(shown.frames) // 2]
    pictures += [
        Picture("moment", "What was sensed and planned at one moment.", maps.inset_figure(shown, middle)),
        Picture("parameters", "Parameters along a trial; dashed: decisions.", maps.parameter_figure(shown)),
    ]
    if failures:
        pictures.append(
            Picture(
                "failures",
                "Trials that failed, coloured by speed.",
                maps.map_figure([found[k] for k in failures]),
            )
        )
    films = tuple(
        Film(
            f"film_{slug(trial_name(found[k].trial))}",
            _caption(found[k].trial),
            gif_bytes(found[k], frames=60, scale=0.65),
        )
        for k in dict.fromkeys([subject, *failures[:FILMS_SHOWN]])
    )
    differences = tuple(f"{trial_name(r.trial)}: {r.difference}" for r in found.values() if r.difference)
    return Replays(tuple(pictures), films, len(found), differences)


def _examples(data: ReportData) -> list[tuple[str, int, int]]:
    """Trial keys of some worlds of the last group, each with every method shown; the last is the last method's."""
    analysis = data.analysis
    group = analysis.groups[-1]
    mean = {w: float(np.mean([analysis.samples[m].times_s[w].mean() for m in analysis.methods])) for w in group.worlds}
    order = sorted(mean, key=lambda w: (mean[w], w))
    worlds = list(dict.fromkeys(order[round(q * (len(order) - 1))] for q in EXAMPLES))
    methods = analysis.methods[-METHODS_SHOWN:]
    return [(m, w, int(analysis.samples[m].trials[w][0])) for w in worlds for m in methods]


def _failures(data: ReportData) -> list[tuple[str, int, int]]:
    """Keys of failed trials to show: the last method's first, each world once before any twice."""
    failed = failed_trials(data)
    order = {m: i for i, m in enumerate(reversed(data.analysis.methods))}
    seen: dict[tuple[str, int], int] = {}
    ranked = []
    for t in failed:
        seen[t.method, t.world] = seen.get((t.method, t.world), 0) + 1
        ranked.append((seen[t.method, t.world], order[t.method], t.world, t))
    chosen = sorted(ranked, key=lambda r: r[:3])
    last = [r[3].key for r in chosen if r[1] == 0][: FAILURES_SHOWN - 2]
    rest = [r[3].key for r in chosen if r[1] > 0]
    return (last + rest)[:FAILURES_SHOWN]


def failed_trials(data: ReportData) -> list[Trial]:
    """Trials that did not reach the goal, under the labels of the analysis, in worlds that it counts."""
    analysis = data.analysis
    worlds = set(analysis.worlds)
    return [t for m in analysis.methods for w in sorted(worlds) for t in analysis.samples[m].rows[w] if not t.success]


def _caption(trial: Trial) -> str:
    return f"{trial_name(trial)}: {trial.outcome} after {trial.time_s:.1f} s, in real time."


def slug(label: str) -> str:
    return re.sub(r"[^A-Za-z0-9.-]+", "_", label)


def origin_of(data: ReportData, trial: Trial) -> tuple[Evaluation, str]:
    """The evaluation a trial lies in and its name there."""
    evaluation, there = data.origin[trial.key]
    return evaluation, trial_name(there)
