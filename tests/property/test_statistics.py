"""Statistics against scipy, statsmodels, hand-computed numbers and planted effects."""

from __future__ import annotations

import math
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import stats
from statsmodels.stats import weightstats
from statsmodels.stats.multitest import multipletests
from statsmodels.stats.proportion import proportion_confint

from appl_dist.evaluate.statistics import (
    benjamini_hochberg,
    bootstrap_interval,
    collect,
    compare,
    performance_profile,
    spearman,
    summarise,
    turned,
    welch_p,
    wilson_interval,
    win_probability,
)

FAILED_S = 70.0
times = st.lists(st.floats(5.0, 70.0), min_size=2, max_size=12)


@given(times, times)
def test_welch_is_statsmodels(a: list[float], b: list[float]) -> None:
    x, y = np.array(a), np.array(b)
    if min(x.std(), y.std()) > 1e-6:
        expected = weightstats.ttest_ind(x, y, usevar="unequal")[1]
        assert welch_p(x, y) == pytest.approx(expected, abs=1e-12)


@given(st.lists(st.floats(0.0, 1.0), min_size=1, max_size=60))
def test_benjamini_hochberg_is_statsmodels(p_values: list[float]) -> None:
    rejected, adjusted, _, _ = multipletests(p_values, alpha=0.05, method="fdr_bh")
    found = benjamini_hochberg(np.array(p_values))
    assert found == pytest.approx(adjusted, abs=1e-12)
    assert ((found <= 0.05) == rejected).all()


@given(st.integers(1, 400), st.data())
def test_wilson_is_statsmodels(count: int, data: st.DataObject) -> None:
    successes = data.draw(st.integers(0, count))
    expected = proportion_confint(successes, count, method="wilson")
    assert wilson_interval(successes, count) == pytest.approx(expected, abs=1e-12)


@given(times, times)
def test_win_probability_is_mann_whitneys_u(a: list[float], b: list[float]) -> None:
    x, y = np.round(a), np.round(b)  # with ties
    expected = stats.mannwhitneyu(y, x).statistic / (len(x) * len(y))
    assert win_probability(x, y) == pytest.approx(expected, abs=1e-12)
    assert win_probability(x, y) + win_probability(y, x) == pytest.approx(1.0, abs=1e-12)


def test_performance_profile_of_a_small_table() -> None:
    times_s = np.array([[10.0, 20.0, 30.0, 40.0], [20.0, 10.0, 30.0, 20.0]])
    shares = performance_profile(times_s, np.array([1.0, 1.5, 2.0]))
    assert shares.tolist() == [[0.5, 0.5, 1.0], [0.75, 0.75, 1.0]]


def test_spearman_is_scipys_and_its_interval_holds_the_truth() -> None:
    rng = np.random.default_rng(8)
    held = 0
    for _ in range(300):
        x, e = rng.normal(size=(2, 50))
        found = spearman(x, 0.6 * x + 0.8 * e)
        assert found.rho == pytest.approx(stats.spearmanr(x, 0.6 * x + 0.8 * e).statistic)
        held += found.low < 6.0 / math.pi * math.asin(0.3) < found.high  # rho of a binormal of correlation 0.6
    assert 270 <= held <= 298
    assert math.isnan(spearman(np.ones(9), np.arange(9.0)).rho)


def test_a_comparison_seen_from_the_other_side() -> None:
    rng = np.random.default_rng(9)
    mean_s = rng.uniform(15.0, 40.0, 20)
    samples = collect(draw("a", mean_s, 6, rng) + draw("b", mean_s - 1.0, 6, rng), FAILED_S)
    there = compare("a", "b", samples, range(20), rng=np.random.default_rng(0))
    back = compare("b", "a", samples, range(20), rng=np.random.default_rng(0))
    seen = turned(there)
    assert (seen.method, seen.better, seen.worse, seen.better_fdr) == ("b", back.better, back.worse, back.better_fdr)
    assert seen.improvement_s == pytest.approx(back.improvement_s)
    assert seen.improvement_percent == pytest.approx(back.improvement_percent)
    assert seen.win_probability == pytest.approx(back.win_probability)
    assert seen.difference_s == pytest.approx(back.difference_s)
    assert (seen.improvement_low_s, seen.win_low) == pytest.approx((back.improvement_low_s, back.win_low), abs=0.2)


def trial(method: str, world: int, number: int, time_s: float, success: bool = True) -> SimpleNamespace:
    return SimpleNamespace(method=method, world=world, trial=number, time_s=time_s, success=success)


def draw(method: str, mean_s: np.ndarray, trials: int, rng: np.random.Generator) -> list[SimpleNamespace]:
    return [trial(method, w, k, m + 2.0 * rng.standard_normal()) for w, m in enumerate(mean_s) for k in range(trials)]


@given(times, times)
def test_welch_is_scipys_and_symmetric(a: list[float], b: list[float]) -> None:
    x, y = np.array(a), np.array(b)
    p = welch_p(x, y)
    assert 0.0 <= p <= 1.0
    assert p == pytest.approx(welch_p(y, x), abs=1e-12)
    if min(x.std(), y.std()) > 1e-6:
        assert p == pytest.approx(float(stats.ttest_ind(x, y, equal_var=False).pvalue), abs=1e-12)


def test_welch_of_a_textbook_example() -> None:
    a, b = np.array([1.0, 2.0, 3.0, 4.0, 5.0]), np.array([3.0, 5.0, 7.0, 9.0, 11.0])
    # By hand: t = (3 - 7) / sqrt(2.5/5 + 10/5) = -2.5298, dof = 2.5^2 / (0.5^2/4 + 2^2/4) = 5.8824
    assert welch_p(a, b) == pytest.approx(2.0 * stats.t.sf(4.0 / math.sqrt(2.5), 100.0 / 17.0), rel=1e-12)
    assert welch_p(a, b) == pytest.approx(0.0453, abs=5e-4)


def test_welch_of_constant_and_lone_samples() -> None:
    failed = np.full(10, FAILED_S)
    assert welch_p(failed, failed) == 1.0
    assert welch_p(failed, np.full(10, 30.0)) == 0.0
    assert welch_p(failed, np.array([30.0, 31.0, 29.0])) < 0.001
    assert welch_p(np.array([1.0]), np.array([2.0, 3.0])) == 1.0


@given(st.integers(1, 400), st.data())
def test_wilson_matches_its_formula(count: int, data: st.DataObject) -> None:
    successes = data.draw(st.integers(0, count))
    low, high = wilson_interval(successes, count)
    z, p = 1.959963984540054, successes / count
    centre = (p + z * z / (2 * count)) / (1 + z * z / count)
    half = z / (1 + z * z / count) * math.sqrt(p * (1 - p) / count + z * z / (4 * count * count))
    assert (low, high) == pytest.approx((centre - half, centre + half), abs=1e-9)
    assert 0.0 <= low <= p <= high <= 1.0


def test_a_failed_trial_counts_seventy_seconds_and_worlds_weigh_the_same() -> None:
    rows = [trial("a", 0, 0, 20.0), trial("a", 0, 1, 50.0, success=False)]
    rows += [trial("a", 1, k, 10.0) for k in range(4)]
    found = summarise("a", collect(rows, FAILED_S)["a"], [0, 1, 2])
    assert found.mean_time_s == pytest.approx((45.0 + 10.0) / 2)  # not (90 + 40) / 6
    assert (found.worlds, found.trials, found.success) == (2, 6, 5 / 6)
    assert math.isnan(summarise("a", collect(rows, FAILED_S)["a"], [7]).mean_time_s)


def test_a_planted_effect_is_found_with_its_sign_and_size() -> None:
    rng = np.random.default_rng(0)
    mean_s = rng.uniform(15.0, 40.0, 50)
    gain_s = np.where(np.arange(50) < 20, 5.0, np.where(np.arange(50) < 30, -5.0, 0.0))
    samples = collect(draw("old", mean_s, 20, rng) + draw("new", mean_s - gain_s, 20, rng), FAILED_S)
    found = compare("new", "old", samples, range(50), rng=rng)
    assert 20 <= found.better <= 23
    assert 10 <= found.worse <= 13
    assert found.improvement_s == pytest.approx(1.0, abs=0.25)
    assert found.improvement_percent == pytest.approx(100.0 / mean_s.mean(), abs=1.0)
    assert found.improvement_low_s < 1.0 < found.improvement_high_s
    assert np.all(found.difference_s[:20] < 0.0)
    turned = compare("old", "new", samples, range(50), rng=rng)
    assert (turned.better, turned.worse) == (found.worse, found.better)
    assert turned.improvement_s == pytest.approx(-found.improvement_s)


def test_with_no_effect_about_one_world_in_twenty_is_significant() -> None:
    rng = np.random.default_rng(1)
    mean_s = rng.uniform(15.0, 40.0, 2000)
    samples = collect(draw("a", mean_s, 8, rng) + draw("b", mean_s, 8, rng), FAILED_S)
    found = compare("a", "b", samples, range(2000), rng=rng, bootstrap_samples=50)
    # 2000 worlds: 100 expected, standard deviation 10, half each way
    assert 60 < found.better + found.worse < 140
    assert 25 < found.better < 75


def test_the_interval_holds_the_truth_about_nineteen_times_in_twenty() -> None:
    rng = np.random.default_rng(2)
    held = 0
    for _ in range(200):
        effects = rng.normal(1.0, 3.0, 40)
        low, high = bootstrap_interval([rng.normal(e, 2.0, 5) for e in effects], rng, 300)
        held += low < 1.0 < high
    assert 180 <= held <= 200


def test_bootstrap_with_uneven_worlds_and_nothing() -> None:
    rng = np.random.default_rng(3)
    constant = [np.full(k, 4.0) for k in (1, 5, 2)]
    assert bootstrap_interval(constant, rng) == pytest.approx((4.0, 4.0))
    assert all(math.isnan(v) for v in bootstrap_interval(constant[:1], rng))
    values = [np.array([float(w)]) for w in range(30)]
    expected = 14.5 + np.array([-1.96, 1.96]) * np.std(np.arange(30)) / math.sqrt(30)
    assert bootstrap_interval(values, rng, 4000) == pytest.approx(tuple(expected), abs=0.4)


@settings(max_examples=25)
@given(st.lists(st.tuples(times, times), min_size=1, max_size=5), st.randoms(use_true_random=False))
def test_order_of_trials_does_not_matter_and_pairs_are_by_number(worlds, random) -> None:  # type: ignore[no-untyped-def]
    rows = []
    for w, (a, b) in enumerate(worlds):
        rows += [trial("a", w, k, t) for k, t in enumerate(a)] + [trial("b", w, k, t) for k, t in enumerate(b)]
    shuffled = rows[:]
    random.shuffle(shuffled)
    first, second = (
        compare("a", "b", collect(r, FAILED_S), range(9), rng=np.random.default_rng(4), bootstrap_samples=20)
        for r in (rows, shuffled)
    )
    assert first.improvement_s == second.improvement_s
    assert first.p_values.tolist() == second.p_values.tolist()
    assert str(first.improvement_low_s) == str(second.improvement_low_s)
    assert first.paired_trials == sum(min(len(a), len(b)) for a, b in worlds)


def test_shared_seeds_narrow_the_interval() -> None:
    rng = np.random.default_rng(5)
    noise = 5.0 * rng.standard_normal((30, 10))
    cells = [(w, k) for w in range(30) for k in range(10)]
    a = [trial("a", w, k, 20.0 + noise[w, k]) for w, k in cells]
    b = [trial("b", w, k, 21.0 + noise[w, k]) for w, k in cells]
    other = [trial("b", w, (k + 1) % 10, t.time_s) for (w, k), t in zip(cells, b, strict=True)]
    paired = compare("a", "b", collect(a + b, FAILED_S), range(30), rng=rng)
    mixed = compare("a", "b", collect(a + other, FAILED_S), range(30), rng=rng)
    assert paired.improvement_low_s == pytest.approx(1.0)
    assert mixed.improvement_high_s - mixed.improvement_low_s > 0.5


def test_methods_without_a_common_world_give_no_numbers() -> None:
    samples = collect([trial("a", 0, 0, 1.0), trial("b", 1, 0, 1.0)], FAILED_S)
    found = compare("a", "b", samples, [0, 1], rng=np.random.default_rng(0))
    assert found.worlds == ()
    assert math.isnan(found.improvement_s)
