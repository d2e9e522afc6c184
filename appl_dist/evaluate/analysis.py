"""From trials to the numbers of the papers' tables; what tables, figures and summary.json are made of."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from appl_dist.evaluate.statistics import Comparison, Samples, Summary, collect, compare, summarise
from appl_dist.evaluate.trials import Trial

DEFAULT, FIXED = "default", "fixed"  # labels of the two baselines: hand-tuned, and best fixed set


@dataclass(frozen=True)
class Group:
    """A set of worlds reported together, such as train or test."""

    name: str
    worlds: tuple[int, ...]
    summaries: Mapping[str, Summary]  # by method
    comparisons: Mapping[tuple[str, str], Comparison]  # by (method, versus), both ways round


@dataclass(frozen=True)
class Analysis:
    """All groups; `methods` in the order asked for. Only worlds in which every method has trials count,
    so that means compare."""

    methods: tuple[str, ...]
    failed_time_s: float
    limit_s: float
    groups: tuple[Group, ...]
    samples: Mapping[str, Samples]
    outcomes: Mapping[str, Mapping[str, int]]  # method, outcome: number of trials

    @property
    def baselines(self) -> tuple[str, ...]:
        return tuple(label for label in (DEFAULT, FIXED) if label in self.methods)


def analyse(
    trials: Sequence[Trial],
    methods: Sequence[str],
    groups: Mapping[str, Sequence[int]],
    *,
    limit_s: float,
    failed_time_s: float,
    seed: int = 0,
) -> Analysis:
    """Summaries and comparisons of every pair of methods in every group of worlds."""
    samples = collect(trials, failed_time_s)
    found = []
    for name, worlds in groups.items():
        common = tuple(w for w in worlds if all(m in samples and w in samples[m].times_s for m in methods))
        if not common:
            continue
        comparisons = {
            (a, b): compare(a, b, samples, common, rng=np.random.default_rng(seed))
            for a in methods
            for b in methods
            if a != b
        }
        summaries = {m: summarise(m, samples[m], common) for m in methods}
        found.append(Group(name, common, summaries, comparisons))
    outcomes = {m: dict(sorted(Counter(t.outcome for t in trials if t.method == m).items())) for m in methods}
    return Analysis(tuple(methods), failed_time_s, limit_s, tuple(found), samples, outcomes)


def as_dict(analysis: Analysis) -> dict[str, Any]:
    """Plain values for JSON; what cannot be computed (nan) is null."""
    groups = {
        g.name: {
            "worlds": list(g.worlds),
            "methods": {m: asdict(s) for m, s in g.summaries.items()},
            "comparisons": [_comparison(c) for c in g.comparisons.values()],
        }
        for g in analysis.groups
    }
    plain: dict[str, Any] = _without_nan({"groups": groups, "outcomes": analysis.outcomes})
    return plain


def _comparison(c: Comparison) -> dict[str, Any]:
    row = asdict(c)
    del row["worlds"]  # the group has them
    return row | {"difference_s": c.difference_s.tolist(), "p_values": c.p_values.tolist()}


def _without_nan(value: Any) -> Any:
    if isinstance(value, dict):
        return {k: _without_nan(v) for k, v in value.items()}
    if isinstance(value, list):
        return [_without_nan(v) for v in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value
