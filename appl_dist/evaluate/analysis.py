"""From trials to the numbers of the papers' tables; what tables, figures and summary.json are made of."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from appl_dist.errors import UserError
from appl_dist.evaluate.statistics import Comparison, Samples, Summary, collect, compare, summarise, turned
from appl_dist.evaluate.trials import Trial

DEFAULT, FIXED = "default", "fixed"  # labels of the two baselines: hand-tuned, and best fixed set


@dataclass(frozen=True)
class Driving:
    """How one method drove, over all trials of some worlds.

    distance_m: mean over trials that reached the goal. clearance_m: median of the trials' least clearances.
    collisions, recoveries: per trial. outcomes: number of trials by outcome.
    """

    distance_m: float
    clearance_m: float
    collisions: float
    recoveries: float
    outcomes: Mapping[str, int]


@dataclass(frozen=True)
class Group:
    """A set of worlds reported together, such as train or test."""

    name: str
    worlds: tuple[int, ...]
    summaries: Mapping[str, Summary]  # by method
    driving: Mapping[str, Driving]  # by method
    comparisons: Mapping[tuple[str, str], Comparison]  # by (method, versus), both ways round


@dataclass(frozen=True)
class Analysis:
    """All groups; `methods` in the order asked for. Only worlds in which every method has trials count,
    so that means compare."""

    protocol: str
    methods: tuple[str, ...]
    failed_time_s: float
    limit_s: float
    groups: tuple[Group, ...]
    samples: Mapping[str, Samples]
    seed: int

    @property
    def baselines(self) -> tuple[str, ...]:
        return tuple(label for label in (DEFAULT, FIXED) if label in self.methods)

    @property
    def worlds(self) -> tuple[int, ...]:
        """Every world of any group, once, by index."""
        return tuple(sorted({w for g in self.groups for w in g.worlds}))

    @property
    def by_speed(self) -> tuple[str, ...]:
        """Methods from slowest to fastest, as the papers order their matrices."""
        everything = self.regroup("", self.worlds, comparisons=False)
        return tuple(sorted(self.methods, key=lambda m: -everything.summaries[m].mean_time_s))

    def regroup(self, name: str, worlds: Sequence[int], *, comparisons: bool = True) -> Group:
        """The same numbers over other worlds of this analysis."""
        return make_group(name, worlds, self.methods, self.samples, self.seed, comparisons=comparisons)


def analyse(
    trials: Sequence[Trial],
    methods: Sequence[str],
    groups: Mapping[str, Sequence[int]],
    *,
    limit_s: float,
    failed_time_s: float,
    seed: int = 0,
) -> Analysis:
    """Summaries and comparisons of every pair of methods in every group of worlds.

    Raises UserError for trials of more than one protocol: their times do not compare.
    """
    protocols = sorted({t.protocol for t in trials})
    if len(protocols) > 1:
        raise UserError(
            f"trials of the protocols {', '.join(protocols)} cannot be compared: "
            "start, goal, limits and collision rule differ, and so do their times; report each by itself"
        )
    samples = collect(trials, failed_time_s)
    found = []
    for name, worlds in groups.items():
        common = tuple(w for w in worlds if all(m in samples and w in samples[m].times_s for m in methods))
        if common:
            found.append(make_group(name, common, methods, samples, seed))
    protocol = protocols[0] if protocols else ""
    return Analysis(protocol, tuple(methods), failed_time_s, limit_s, tuple(found), samples, seed)


def make_group(
    name: str,
    worlds: Sequence[int],
    methods: Sequence[str],
    samples: Mapping[str, Samples],
    seed: int,
    *,
    comparisons: bool = True,
) -> Group:
    """Everything about `worlds`, in all of which every method has trials."""
    compared: dict[tuple[str, str], Comparison] = {}
    for i, a in enumerate(methods if comparisons else ()):
        for b in methods[:i]:
            c = compare(a, b, samples, worlds, rng=np.random.default_rng(seed))
            compared |= {(a, b): c, (b, a): turned(c)}
    return Group(
        name,
        tuple(worlds),
        {m: summarise(m, samples[m], worlds, np.random.default_rng(seed)) for m in methods},
        {m: _driving(samples[m], worlds) for m in methods},
        compared,
    )


def _driving(samples: Samples, worlds: Sequence[int]) -> Driving:
    rows = [t for w in worlds for t in samples.rows[w]]
    reached_m = [t.distance_m for t in rows if t.success]
    return Driving(
        distance_m=float(np.mean(reached_m)) if reached_m else math.nan,
        clearance_m=float(np.median([t.min_clearance_m for t in rows])) if rows else math.nan,
        collisions=sum(t.collisions for t in rows) / max(1, len(rows)),
        recoveries=sum(t.recoveries for t in rows) / max(1, len(rows)),
        outcomes=dict(sorted(Counter(t.outcome for t in rows).items())),
    )


def as_dict(analysis: Analysis) -> dict[str, Any]:
    """Plain values for JSON; what cannot be computed (nan) is null."""
    groups = {
        g.name: {
            "worlds": list(g.worlds),
            "methods": {m: asdict(s) | asdict(g.driving[m]) for m, s in g.summaries.items()},
            "comparisons": [_comparison(c) for c in g.comparisons.values()],
        }
        for g in analysis.groups
    }
    plain: dict[str, Any] = without_nan({"protocol": analysis.protocol, "groups": groups})
    return plain


def _comparison(c: Comparison) -> dict[str, Any]:
    row = asdict(c) | {"improvement_s": c.improvement_s, "improvement_percent": c.improvement_percent}
    del row["worlds"]  # the group has them
    return row | {k: row[k].tolist() for k in ("difference_s", "p_values", "q_values")}


def without_nan(value: Any) -> Any:
    """Plain values with null for what JSON has no number for."""
    if isinstance(value, dict):
        return {k: without_nan(v) for k, v in value.items()}
    if isinstance(value, list | tuple):
        return [without_nan(v) for v in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value
