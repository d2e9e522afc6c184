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
    mean_over_worlds,
    performance_profile,
    spearman,
    success_interval,
    summarise,
    turned,
    welch_p,
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


@given(st.integers(2, 200), st.data())
def test_success_with_one_trial_a_world_is_about_statsmodels_wilson(worlds: int, data: st.DataObject) -> None:
    successes = data.draw(st.integers(0, worlds))
    rates = np.array([1.0] * successes + [0.0] * (worlds - successes))
    low, high = proportion_confint(successes, worlds, method="wilson")
    found = success_interval(rates, worlds)
    assert 0.0 <= found[0] <= low + 1e-9
    assert high - 1e-9 <= found[1] <= 1.0  # a little wider: the variance is estimated
    if worlds > 100:
        assert found == pytest.approx((low, high), abs=0.01)


@given(st.lists(st.tuples(st.integers(0, 9), st.integers(1, 9)), min_size=2, max_size=40))
def test_the_success_interval_contains_its_estimate(worlds: list[tuple[int, int]]) -> None:
    rates = np.array([min(s, n) / n for s, n in worlds])
    low, high = success_interval(rates, sum(n for _, n in worlds))
    assert 0.0 <= low <= rates.mean() <= high <= 1.0
    assert low < high


@pytest.mark.parametrize(("mean", "alike"), [(0.5, 0.5), (0.9, 0.3), (0.9, 0.0), (0.98, 0.5)])
def test_success_intervals_hold_the_truth_when_trials_of_a_world_are_alike(mean: float, alike: float) -> None:
    """alike: correlation of two trials of one world (beta-binomial). Wilson over all trials would fail at 0.5."""
    rng = np.random.default_rng(10)
    held = wilson_held = 0
    for _ in range(400):
        size = 1.0 / alike - 1.0 if alike else 1e9
        p = rng.beta(mean * size, (1.0 - mean) * size, 50)
        successes = rng.binomial(10, p)
        low, high = success_interval(successes / 10, 500)
        held += low <= mean <= high
        plain = proportion_confint(successes.sum(), 500, method="wilson")
        wilson_held += plain[0] <= mean <= plain[1]
    assert held >= 364  # 380 expected; 91 %
    assert alike < 0.5 or wilson_held < 300


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


def test_a_failed_trial_counts_seventy_seconds_and_worlds_weigh_the_same() -> None:
    rows = [trial("a", 0, 0, 20.0), trial("a", 0, 1, 50.0, success=False)]
    rows += [trial("a", 1, k, 10.0) for k in range(4)]
    found = summarise("a", collect(rows, FAILED_S)["a"], [0, 1, 2])
    assert found.mean_time_s == pytest.approx((45.0 + 10.0) / 2)  # not (90 + 40) / 6
    assert (found.worlds, found.trials, found.success) == (2, 6, 0.75)  # not 5 / 6
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
        low, high = bootstrap_interval([(rng.normal(e, 2.0, 5) / 5,) for e in effects], rng, 300)
        held += low < 1.0 < high
    assert 180 <= held <= 200


def test_differences_of_unequal_trial_numbers_hold_the_truth() -> None:
    """One method with 20 trials a world, the other with 2, half of them paired."""
    rng = np.random.default_rng(11)
    held = 0
    for _ in range(200):
        mean_s = rng.uniform(15.0, 40.0, 40)
        versus = [
            trial("b", w, k, m + 1.0 + 2.0 * rng.standard_normal()) for w, m in enumerate(mean_s) for k in (0, 90)
        ]
        samples = collect(draw("a", mean_s, 20, rng) + versus, FAILED_S)
        found = compare("a", "b", samples, range(40), rng=rng, bootstrap_samples=300)
        held += found.improvement_low_s < 1.0 < found.improvement_high_s
    assert 180 <= held <= 200


numbered = st.dictionaries(st.integers(0, 12), st.sampled_from([8.0, 10.0, 11.5, 30.0, 70.0]), min_size=1, max_size=9)


@settings(max_examples=100, deadline=None)
@given(st.lists(st.tuples(numbered, numbered), min_size=2, max_size=6))
def test_every_interval_contains_its_estimate(worlds: list[tuple[dict[int, float], dict[int, float]]]) -> None:
    rows = [trial("a", w, k, t, t < 70.0) for w, (a, _) in enumerate(worlds) for k, t in a.items()]
    rows += [trial("b", w, k, t, t < 70.0) for w, (_, b) in enumerate(worlds) for k, t in b.items()]
    samples = collect(rows, FAILED_S)
    c = compare("a", "b", samples, range(6), rng=np.random.default_rng(0), bootstrap_samples=100)
    assert c.improvement_low_s <= c.improvement_s + 1e-9
    assert c.improvement_s - 1e-9 <= c.improvement_high_s
    assert c.win_low - 1e-9 <= c.win_probability <= c.win_high + 1e-9
    for method in "ab":
        s = summarise(method, samples[method], range(6))
        assert s.mean_time_low_s - 1e-9 <= s.mean_time_s <= s.mean_time_high_s + 1e-9
        assert s.success_low <= s.success <= s.success_high


def test_forty_trials_against_two() -> None:
    """The two common numbers are equal, the other 38 are not: the interval is that of all trials."""
    rng = np.random.default_rng(12)
    a = [trial("a", w, k, 10.0 if k < 2 else 15.0 + rng.standard_normal()) for w in range(10) for k in range(40)]
    b = [trial("b", w, k, 10.0) for w in range(10) for k in range(2)]
    found = compare("a", "b", collect(a + b, FAILED_S), range(10), rng=rng)
    assert found.improvement_s == pytest.approx(-4.75, abs=0.1)
    assert found.improvement_low_s < found.improvement_s < found.improvement_high_s < -4.0


def test_the_bootstrap_is_that_of_a_plain_loop() -> None:
    """Against an independent implementation: worlds drawn, then pairs, then lone trials of either method."""
    rng = np.random.default_rng(13)
    rows = []
    for w in range(12):
        gain_s = rng.normal(0.0, 3.0)
        for k in range(6):
            noise = rng.normal(0.0, 4.0)
            rows.append(trial("a", w, k, 30.0 + gain_s + noise))
            if k < 3:
                rows.append(trial("b", w, k, 30.0 + noise))
        rows.append(trial("b", w, 50, 30.0 + rng.normal(0.0, 4.0)))
    by_cell = {(t.method, t.world, t.trial): t.time_s for t in rows}
    means = []
    for _ in range(3000):
        values = []
        for w in rng.integers(12, size=12):
            common, lone = rng.integers(3, size=3), 3 + rng.integers(3, size=3)
            a = [by_cell["a", w, k] for k in (*common, *lone)]
            b = [by_cell["b", w, k] for k in (*common, 50)]
            values.append(np.mean(a) - np.mean(b))
        means.append(np.mean(values))
    expected = np.quantile(means, [0.025, 0.975])
    found = compare("a", "b", collect(rows, FAILED_S), range(12), rng=rng, bootstrap_samples=4000)
    assert (-found.improvement_high_s, -found.improvement_low_s) == pytest.approx(tuple(expected), abs=0.12)
    assert found.paired_trials == 36


def test_bootstrap_with_uneven_worlds_and_nothing() -> None:
    rng = np.random.default_rng(3)
    constant = [(np.full(k, 4.0 / k),) for k in (1, 5, 2)]
    assert mean_over_worlds([np.array([1.0]), np.array([2.0, 4.0])]) == 2.0
    assert bootstrap_interval(constant, rng) == pytest.approx((4.0, 4.0))
    assert all(math.isnan(v) for v in bootstrap_interval(constant[:1], rng))
    values = [(np.array([float(w)]),) for w in range(30)]
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
