"""Statistics of the APPL papers' evaluations: traversal times, significance per world, intervals.

A failed trial counts `failed_time_s` (70 s in the papers). A world's time is the mean of its trials,
a method's time the mean over worlds (journal Tab. V). Per world, two methods are compared by Welch's
t-test at p < 0.05 (journal Tab. VI, Fig. 8), which, as in the papers, ignores that trials are paired by
seed and is not corrected for the number of worlds: with no effect about 5 % of worlds are significant,
half each way. Beside it stand the same counts at a false discovery rate of 5 % (Benjamini and Hochberg 1995),
where with no effect at all there is none in 19 of 20 evaluations. The bootstrap interval uses the pairs.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import stats

Array = NDArray[np.float64]

SIGNIFICANCE = 0.05
BOOTSTRAP_SAMPLES = 2000


@dataclass(frozen=True)
class Samples:
    """One method's trials per world, by trial number: (k,) counted times, (k,) numbers, the rows, and successes."""

    times_s: Mapping[int, Array]
    trials: Mapping[int, NDArray[np.int64]]
    rows: Mapping[int, tuple[Any, ...]]
    successes: Mapping[int, int]

    @property
    def worlds(self) -> list[int]:
        return sorted(self.times_s)


@dataclass(frozen=True)
class Summary:
    """One method over some worlds. Intervals of 95 %: of the mean time by bootstrap over worlds and trials; of
    success by Wilson over all trials, as if they were independent; trials of one world are alike, so over worlds yet
    unseen it is wider."""

    method: str
    worlds: int
    trials: int
    mean_time_s: float
    mean_time_low_s: float
    mean_time_high_s: float
    success: float
    success_low: float
    success_high: float


@dataclass(frozen=True)
class Comparison:
    """`method` against `versus` over the worlds both were tried in.

    improvement_s is the mean over worlds of (versus - method), positive if `method` is faster, with its
    95 % bootstrap interval. better and worse count worlds with p < 0.05, better_fdr and worse_fdr those that
    Benjamini and Hochberg's procedure keeps at a false discovery rate of 5 %. win_probability: the chance that a
    trial of `method` is faster than one of `versus` in the same world, ties counting half, mean over worlds, with
    the 95 % interval of resampled worlds (the probability of improvement of Agarwal et al. 2021).
    Per world, in the order of `worlds`: difference_s (n,) = method - versus as in journal Fig. 8, p_values (n,),
    q_values (n,): p adjusted for the false discovery rate.
    """

    method: str
    versus: str
    mean_s: float
    versus_mean_s: float
    improvement_low_s: float
    improvement_high_s: float
    better: int
    worse: int
    better_fdr: int
    worse_fdr: int
    win_probability: float
    win_low: float
    win_high: float
    paired_trials: int
    worlds: tuple[int, ...]
    difference_s: Array
    p_values: Array
    q_values: Array

    @property
    def improvement_s(self) -> float:
        return self.versus_mean_s - self.mean_s

    @property
    def improvement_percent(self) -> float:
        return 100.0 * self.improvement_s / self.versus_mean_s

    @property
    def significant(self) -> NDArray[np.bool_]:
        return self.p_values < SIGNIFICANCE


def collect(trials: Iterable[Any], failed_time_s: float) -> dict[str, Samples]:
    """`Trial`s by method; a failed trial counts `failed_time_s`, however long it took."""
    rows: dict[str, dict[int, list[Any]]] = {}
    for t in trials:
        rows.setdefault(t.method, {}).setdefault(t.world, []).append(t)
    result = {}
    for method, by_world in rows.items():
        ordered = {world: sorted(by_world[world], key=lambda t: t.trial) for world in sorted(by_world)}
        result[method] = Samples(
            times_s={w: np.array([t.time_s if t.success else failed_time_s for t in r]) for w, r in ordered.items()},
            trials={w: np.array([t.trial for t in r], np.int64) for w, r in ordered.items()},
            rows={w: tuple(r) for w, r in ordered.items()},
            successes={w: sum(t.success for t in r) for w, r in ordered.items()},
        )
    return result


def summarise(method: str, samples: Samples, worlds: Iterable[int], rng: np.random.Generator | None = None) -> Summary:
    """Mean over those of `worlds` that have trials; the mean is over worlds, not over trials."""
    chosen = [w for w in worlds if w in samples.times_s]
    count = sum(len(samples.times_s[w]) for w in chosen)
    successes = sum(samples.successes[w] for w in chosen)
    low, high = wilson_interval(successes, count)
    times = [samples.times_s[w] for w in chosen]
    time_low, time_high = bootstrap_interval(times, rng or np.random.default_rng(0))
    return Summary(
        method=method,
        worlds=len(chosen),
        trials=count,
        mean_time_s=float(np.mean([t.mean() for t in times])) if chosen else float("nan"),
        mean_time_low_s=time_low,
        mean_time_high_s=time_high,
        success=successes / count if count else float("nan"),
        success_low=low,
        success_high=high,
    )


def compare(
    method: str,
    versus: str,
    samples: Mapping[str, Samples],
    worlds: Iterable[int],
    *,
    rng: np.random.Generator,
    bootstrap_samples: int = BOOTSTRAP_SAMPLES,
) -> Comparison:
    """Compare two methods over those of `worlds` in which both have trials."""
    a, b = samples[method], samples[versus]
    common = [w for w in worlds if w in a.times_s and w in b.times_s]
    nothing = np.zeros(0)
    if not common:
        nan = float("nan")
        return Comparison(
            method, versus, nan, nan, nan, nan, 0, 0, 0, 0, nan, nan, nan, 0, (), nothing, nothing, nothing
        )
    means_a = np.array([a.times_s[w].mean() for w in common])
    means_b = np.array([b.times_s[w].mean() for w in common])
    p_values = np.array([welch_p(a.times_s[w], b.times_s[w]) for w in common])
    difference_s = means_a - means_b
    q_values = benjamini_hochberg(p_values)
    faster, slower = difference_s < 0.0, difference_s > 0.0
    wins = [np.array([win_probability(a.times_s[w], b.times_s[w])]) for w in common]
    win_low, win_high = bootstrap_interval(wins, rng, bootstrap_samples)
    paired = [_pairs(a, b, w) for w in common]
    low, high = bootstrap_interval([p for p in paired if len(p)], rng, bootstrap_samples)
    return Comparison(
        method=method,
        versus=versus,
        mean_s=float(means_a.mean()),
        versus_mean_s=float(means_b.mean()),
        improvement_low_s=-high,
        improvement_high_s=-low,
        better=int(np.sum((p_values < SIGNIFICANCE) & faster)),
        worse=int(np.sum((p_values < SIGNIFICANCE) & slower)),
        better_fdr=int(np.sum((q_values < SIGNIFICANCE) & faster)),
        worse_fdr=int(np.sum((q_values < SIGNIFICANCE) & slower)),
        win_probability=float(np.mean(wins)),
        win_low=win_low,
        win_high=win_high,
        paired_trials=sum(len(p) for p in paired),
        worlds=tuple(common),
        difference_s=difference_s,
        p_values=p_values,
        q_values=q_values,
    )


def turned(c: Comparison) -> Comparison:
    """The same comparison seen from the other method."""
    return replace(
        c,
        method=c.versus,
        versus=c.method,
        mean_s=c.versus_mean_s,
        versus_mean_s=c.mean_s,
        improvement_low_s=-c.improvement_high_s,
        improvement_high_s=-c.improvement_low_s,
        better=c.worse,
        worse=c.better,
        better_fdr=c.worse_fdr,
        worse_fdr=c.better_fdr,
        win_probability=1.0 - c.win_probability,
        win_low=1.0 - c.win_high,
        win_high=1.0 - c.win_low,
        difference_s=-c.difference_s,
    )


def benjamini_hochberg(p_values: Array) -> Array:
    """(n,) p-values adjusted so that those below 5 % hold at most 5 % false discoveries in expectation."""
    if len(p_values) == 0:
        return p_values
    adjusted: Array = stats.false_discovery_control(p_values, method="bh")
    return adjusted


def win_probability(a: Array, b: Array) -> float:
    """Chance that a draw of a (n,) is less than one of b (m,), ties half: Mann and Whitney's U / (n m)."""
    ordered = np.sort(b)
    below, up_to = np.searchsorted(ordered, a, "left"), np.searchsorted(ordered, a, "right")
    return float(1.0 - (below + up_to).sum() / (2.0 * len(a) * len(b)))


def performance_profile(times_s: Array, ratios: Array) -> Array:
    """(methods, ratios) share of worlds in which a method needs at most `ratio` times the best method's time.

    times_s: (methods, worlds) mean times. Source: Dolan and Moré 2002.
    """
    relative = times_s / times_s.min(axis=0)
    shares: Array = (relative[:, :, None] <= ratios * (1.0 + 1e-12)).mean(axis=1)
    return shares


@dataclass(frozen=True)
class Correlation:
    """Spearman's rank correlation, its 95 % interval (Bonett and Wright 2000) and two-sided p-value."""

    rho: float
    low: float
    high: float
    p_value: float


def spearman(x: Array, y: Array) -> Correlation:
    """Rank correlation of x (n,) and y (n,); nan where either is constant or n < 4."""
    nan = float("nan")
    if len(x) < 4 or np.ptp(x) == 0.0 or np.ptp(y) == 0.0:
        return Correlation(nan, nan, nan, nan)
    found = stats.spearmanr(x, y)
    rho = float(found.statistic)
    half = 1.959963984540054 * np.sqrt((1.0 + rho * rho / 2.0) / (len(x) - 3))
    with np.errstate(divide="ignore"):
        z = np.arctanh(rho)
    return Correlation(rho, float(np.tanh(z - half)), float(np.tanh(z + half)), float(found.pvalue))


def welch_p(a: Array, b: Array) -> float:
    """Two-sided p-value of Welch's t-test of samples a (n,), b (m,).

    Where the test is undefined the answer is the sensible limit: two constant samples give 1 if they are
    equal and 0 if not (all of a world's trials may fail and count the same); a lone trial gives 1.
    """
    if min(len(a), len(b)) < 2:
        return 1.0
    if np.ptp(a) == 0.0 and np.ptp(b) == 0.0:
        return 1.0 if a[0] == b[0] else 0.0
    moments = (a.mean(), a.std(ddof=1), len(a), b.mean(), b.std(ddof=1), len(b))
    return float(stats.ttest_ind_from_stats(*moments, equal_var=False).pvalue)


def wilson_interval(successes: int, count: int, confidence: float = 0.95) -> tuple[float, float]:
    """Wilson score interval of a proportion; (nan, nan) of nothing."""
    if count == 0:
        return float("nan"), float("nan")
    interval = stats.binomtest(successes, count).proportion_ci(confidence, method="wilson")
    return float(interval.low), float(interval.high)


def bootstrap_interval(
    samples: Sequence[Array],
    rng: np.random.Generator,
    resamples: int = BOOTSTRAP_SAMPLES,
    confidence: float = 0.95,
) -> tuple[float, float]:
    """Percentile interval of the mean over worlds of the mean over trials, resampling worlds, then
    trials within them; `samples[i]` (k_i,) are the values of world i. (nan, nan) of fewer than 2 worlds."""
    if len(samples) < 2:
        return float("nan"), float("nan")
    counts = np.array([len(s) for s in samples])
    offsets = np.concatenate([[0], np.cumsum(counts)[:-1]])
    values = np.concatenate(list(samples))
    means = np.empty(resamples)
    chunk = max(1, 2_000_000 // (len(samples) * int(counts.max())))  # about 16 MB an array
    for start in range(0, resamples, chunk):
        n = min(chunk, resamples - start)
        worlds = rng.integers(len(samples), size=(n, len(samples)))
        k = counts[worlds][..., None]  # (n, worlds, 1)
        index = (rng.random((n, len(samples), int(counts.max()))) * k).astype(np.int64)
        drawn = values[offsets[worlds][..., None] + index]
        drawn *= np.arange(counts.max()) < k  # a world of k trials is resampled k times
        means[start : start + n] = (drawn.sum(axis=2) / k[..., 0]).mean(axis=1)
    low, high = np.quantile(means, [(1.0 - confidence) / 2.0, (1.0 + confidence) / 2.0])
    return float(low), float(high)


def _pairs(a: Samples, b: Samples, world: int) -> Array:
    """(k,) differences a - b of the trials that both have, paired by trial index, hence by seed."""
    _, in_a, in_b = np.intersect1d(a.trials[world], b.trials[world], return_indices=True)
    difference: Array = a.times_s[world][in_a] - b.times_s[world][in_b]
    return difference
