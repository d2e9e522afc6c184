"""Statistics of the APPL papers' evaluations: traversal times, significance per world, intervals.

Estimands. A failed trial counts `failed_time_s` (70 s in the papers). A world's value is the mean of its trials, a
method's value the mean over worlds (journal Tab. V), for times, success and scores alike. A difference is the mean
over worlds of the difference of the world's means, over all trials of both methods.

Intervals (95 %). Each comes from the same trials and the same estimator as its number: worlds are resampled with
replacement, then trials within each world (hierarchical percentile bootstrap, `bootstrap_interval`). Trial numbers
that both methods have share their seed and are resampled together; the others are resampled within their method.
Resampling both levels is slightly conservative (Davison and Hinkley 1997, section 3.8). Success is the exception:
a bootstrap of nothing but successes has no width, so `success_interval` is Wilson's with a design effect.
With fewer than two worlds there is no interval.

Significance. Per world, two methods are compared by Welch's t-test at p < 0.05 (journal Tab. VI, Fig. 8), which, as
in the papers, ignores pairs and is not corrected for the number of worlds: with no effect about 5 % of worlds are
significant, half each way. Beside it stand the same counts at a false discovery rate of 5 % (Benjamini and Hochberg
1995), where with no effect at all there is none in 19 of 20 evaluations.
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
    """One method over some worlds, all means over worlds; 95 % intervals (see the module's docstring)."""

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

    improvement_s is the mean over worlds of (versus - method), positive if `method` is faster, with its 95 % interval.
    better and worse count worlds with p < 0.05, better_fdr and worse_fdr those that Benjamini and Hochberg's procedure
    keeps at a false discovery rate of 5 %. win_probability: the chance that a trial of `method` is faster than one of
    `versus` in the same world, ties counting half, mean over worlds (the probability of improvement of Agarwal et al.
    2021), with its 95 % interval. paired_trials: trials of `method` that `versus` has with the same number.
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
    rng = rng or np.random.default_rng(0)
    times = [samples.times_s[w] for w in chosen]
    rates = np.array([samples.successes[w] / len(samples.times_s[w]) for w in chosen])
    trials = sum(map(len, times))
    low, high = success_interval(rates, trials)
    time_low, time_high = bootstrap_interval([(t / len(t),) for t in times], rng)
    return Summary(
        method=method,
        worlds=len(chosen),
        trials=trials,
        mean_time_s=mean_over_worlds(times),
        mean_time_low_s=time_low,
        mean_time_high_s=time_high,
        success=float(rates.mean()) if chosen else float("nan"),
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
    strata = [_strata(a.trials[w], b.trials[w]) for w in common]
    times = [(a.times_s[w], b.times_s[w]) for w in common]
    differences = [_split(k, x / len(x), -y / len(y)) for k, (x, y) in zip(strata, times, strict=True)]
    low, high = bootstrap_interval(differences, rng, bootstrap_samples)
    wins = np.array([win_probability(x, y) for x, y in times])
    placements = [_split(k, *_win_parts(x, y)) for k, (x, y) in zip(strata, times, strict=True)]
    win_low, win_high = np.clip(bootstrap_interval(placements, rng, bootstrap_samples), 0.0, 1.0).tolist()
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
        win_probability=float(wins.mean()),
        win_low=win_low,
        win_high=win_high,
        paired_trials=sum(len(k[0]) for k in strata),
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
    return float(_wins(a, b).mean())


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


def mean_over_worlds(values: Sequence[Array]) -> float:
    """Mean over worlds of the mean over trials; values[i] (k_i,) of world i. nan of no world."""
    return float(np.mean([v.mean() for v in values])) if len(values) else float("nan")


def success_interval(rates: Array, trials: int) -> tuple[float, float]:
    """95 % interval of the mean over worlds of success rates (worlds,), from `trials` trials in all.

    Wilson's interval with an effective number of trials (Korn and Graubard 1998; Franco et al. 2019): p (1 - p) over
    the variance of the mean, which is that of the worlds' rates, with that variance's degrees of freedom; never more
    than there are trials. For it a world of the rarer outcome is added: few or no failures say little of how alike the
    trials of a world are, and each world then counts nearly as one trial. (nan, nan) of fewer than 2 worlds.
    """
    worlds = len(rates)
    if worlds < 2:
        return float("nan"), float("nan")
    p = float(rates.mean())
    known = np.append(rates, 0.0 if p > 0.5 else 1.0)
    design = float(known.var(ddof=1) / (known.mean() * (1.0 - known.mean())))  # variance of a world's rate in p (1 - p)
    narrowing = float(stats.norm.ppf(0.975) / stats.t.ppf(0.975, worlds - 1))
    low, high = _wilson(p, min(trials, worlds / design * narrowing**2))
    return min(low, p), max(high, p)  # equal but for rounding where p is 0 or 1


def _wilson(p: float, n: float) -> tuple[float, float]:
    """Wilson's score interval of a proportion of `n` trials, which need not be whole."""
    z = float(stats.norm.ppf(0.975))
    centre = (p + z * z / (2.0 * n)) / (1.0 + z * z / n)
    half = z / (1.0 + z * z / n) * np.sqrt(p * (1.0 - p) / n + z * z / (4.0 * n * n))
    return max(0.0, float(centre - half)), min(1.0, float(centre + half))


def bootstrap_interval(
    worlds: Sequence[Sequence[Array]],
    rng: np.random.Generator,
    resamples: int = BOOTSTRAP_SAMPLES,
    confidence: float = 0.95,
) -> tuple[float, float]:
    """Percentile interval of the mean over worlds of the sum of all parts of a world.

    worlds[i]: the strata of world i, each (k,) parts that its trials add to the world's value, such as t / k for a mean
    of k times. Worlds are resampled, then the trials of each stratum. The interval always contains the estimate.
    (nan, nan) of fewer than 2 worlds.
    """
    if len(worlds) < 2:
        return float("nan"), float("nan")
    totals = np.zeros(resamples)
    drawn = rng.integers(len(worlds), size=(resamples, len(worlds)))
    for stratum in range(max(map(len, worlds))):
        totals += _resampled([w[stratum] if stratum < len(w) else np.zeros(0) for w in worlds], drawn, rng)
    low, high = np.quantile(totals, [(1.0 - confidence) / 2.0, (1.0 + confidence) / 2.0])
    estimate = float(np.mean([sum(float(part.sum()) for part in w) for w in worlds]))
    return min(float(low), estimate), max(float(high), estimate)


def _resampled(parts: Sequence[Array], drawn: NDArray[np.int64], rng: np.random.Generator) -> Array:
    """(resamples,) means over the `drawn` worlds (resamples, worlds) of the sum of resampled parts of each."""
    counts = np.array([len(p) for p in parts])
    most = int(counts.max())
    sums = np.zeros(len(drawn))
    if most == 0:
        return sums
    offsets = np.concatenate([[0], np.cumsum(counts)[:-1]])
    values = np.append(np.concatenate(list(parts)), 0.0)  # the last stands for what a world does not have
    chunk = max(1, 2_000_000 // (len(parts) * most))  # about 16 MB an array
    for start in range(0, len(drawn), chunk):
        worlds = drawn[start : start + chunk]
        k = counts[worlds][..., None]  # (n, worlds, 1)
        index = offsets[worlds][..., None] + (rng.random((*worlds.shape, most)) * k).astype(np.int64)
        index[np.arange(most) >= k] = -1  # k trials are resampled k times
        sums[start : start + chunk] = values[index].sum(axis=2).mean(axis=1)
    return sums


_Indices = NDArray[np.int64]


def _strata(a: _Indices, b: _Indices) -> tuple[_Indices, _Indices, _Indices, _Indices]:
    """Where the trial numbers that both have lie in a and in b, then those of a alone and those of b alone."""
    _, in_a, in_b = np.intersect1d(a, b, return_indices=True)
    return in_a, in_b, np.delete(np.arange(len(a)), in_a), np.delete(np.arange(len(b)), in_b)


def _split(strata: tuple[_Indices, _Indices, _Indices, _Indices], a: Array, b: Array) -> tuple[Array, Array, Array]:
    """Parts of a world by stratum: of trials that both methods have, of the first alone, of the second alone."""
    in_a, in_b, only_a, only_b = strata
    return a[in_a] + b[in_b], a[only_a], b[only_b]


def _win_parts(a: Array, b: Array) -> tuple[Array, Array]:
    """What each trial of a (n,) and b (m,) adds to `win_probability(a, b)`, to first order (Hoeffding's projection)."""
    wins = _wins(a, b)
    return (wins.mean(axis=1) - wins.mean()) / len(a), wins.mean(axis=0) / len(b)


def _wins(a: Array, b: Array) -> Array:
    """(n, m) 1 where a (n,) is less than b (m,), 0.5 where equal."""
    return np.heaviside(b[None, :] - a[:, None], 0.5)
