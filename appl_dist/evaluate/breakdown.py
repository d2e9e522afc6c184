"""Where a method gains: by difficulty, by BARN's generation sets, by the five metrics; and the BARN Challenge score."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from appl_dist.evaluate.analysis import Analysis, Group
from appl_dist.evaluate.folder import Course
from appl_dist.evaluate.statistics import (
    Correlation,
    Samples,
    benjamini_hochberg,
    bootstrap_interval,
    mean_over_worlds,
    spearman,
)
from appl_dist.sim.difficulty import NAMES
from appl_dist.sim.generate import FILLS, SMOOTHINGS

THIRDS = ("easy", "medium", "difficult")
CLIPS = {"since 2024": (2.0, 8.0), "before 2024": (4.0, 8.0)}  # in optimal times


def thirds(analysis: Analysis, base: str) -> list[Group]:
    """The worlds in thirds of `base`'s mean time, fastest first, as ICRA 2021 Tab. III; each third also by group.

    `base` is sorted by the very trials it is then compared in: chance puts its slow worlds into the last third,
    where another method therefore looks a little better than it is, and worse in the first.
    """
    means = {w: float(analysis.samples[base].times_s[w].mean()) for w in analysis.worlds}
    order = sorted(means, key=lambda w: (means[w], w))
    if len(order) < len(THIRDS):
        return []
    found = []
    for name, part in zip(THIRDS, np.array_split(np.array(order), len(THIRDS)), strict=True):
        chosen = {int(w) for w in part}
        named = [(f"{name} {g.name}", sorted(chosen & set(g.worlds))) for g in analysis.groups]
        if len(named) > 1:
            named.append((f"{name} all", sorted(chosen)))
        found += [analysis.regroup(label, worlds) for label, worlds in named if worlds]
    return found


def generation_sets(analysis: Analysis, courses: Mapping[int, Course]) -> list[Group]:
    """The worlds by fill and smoothing of the generator: BARN's twelve sets of 25."""
    by_set: dict[int, list[int]] = {}
    for w in analysis.worlds:
        by_set.setdefault(courses[w].set_index, []).append(w)
    return [analysis.regroup(set_name(i), by_set[i], comparisons=False) for i in sorted(by_set)]


def set_name(index: int) -> str:
    fill, smoothing = divmod(index, len(SMOOTHINGS))
    return f"{100 * FILLS[fill]:.0f} % filled, {SMOOTHINGS[smoothing]} smoothings"


@dataclass(frozen=True)
class DifficultyRow:
    """How `what` goes with one difficulty metric over worlds; q_value: adjusted over all rows of a table."""

    what: str
    metric: str
    correlation: Correlation
    q_value: float


def difficulty(analysis: Analysis, courses: Mapping[int, Course]) -> list[DifficultyRow]:
    """Rank correlations of each method's mean time, and of its improvement over the baselines, with each metric."""
    worlds = analysis.worlds
    metrics = np.array([courses[w].metrics for w in worlds])  # (worlds, 5)
    means = {m: np.array([analysis.samples[m].times_s[w].mean() for w in worlds]) for m in analysis.methods}
    values = {f"time of {m}": means[m] for m in analysis.methods}
    for base in analysis.baselines:
        values |= {
            f"{m} faster than {base}": means[base] - means[m] for m in analysis.methods if m not in analysis.baselines
        }
    rows = [(what, name, spearman(v, metrics[:, k])) for what, v in values.items() for k, name in enumerate(NAMES)]
    p = np.array([c.p_value for _, _, c in rows])
    q = np.full(len(p), np.nan)
    q[np.isfinite(p)] = benjamini_hochberg(p[np.isfinite(p)])
    return [DifficultyRow(*row, float(qi)) for row, qi in zip(rows, q, strict=True)]


@dataclass(frozen=True)
class Score:
    """BARN Challenge score of a method: mean over worlds of the mean over trials, with its 95 % interval."""

    method: str
    clip: str
    score: float
    low: float
    high: float
    best: float  # the highest score the clip allows


def challenge_scores(analysis: Analysis, courses: Mapping[int, Course]) -> list[Score]:
    """1[success] OT / clip(time, low OT, high OT) under both published clips."""
    found = []
    for method in analysis.methods:
        for clip, (low, high) in CLIPS.items():
            scores = [
                trial_scores(analysis.samples[method], w, courses[w].optimal_time_s, low, high) for w in analysis.worlds
            ]
            interval = bootstrap_interval([(s / len(s),) for s in scores], np.random.default_rng(analysis.seed))
            found.append(Score(method, clip, mean_over_worlds(scores), *interval, 1.0 / low))
    return found


def trial_scores(samples: Samples, world: int, optimal_time_s: float, low: float, high: float) -> NDArray[np.float64]:
    """(k,) scores of the trials in one world."""
    rows: Sequence = samples.rows[world]
    times_s = np.clip([t.time_s for t in rows], low * optimal_time_s, high * optimal_time_s)
    return np.where([t.success for t in rows], optimal_time_s / times_s, 0.0)
