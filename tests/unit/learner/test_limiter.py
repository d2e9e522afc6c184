from __future__ import annotations

import math

import pytest

from appl_dist.learner.limiter import LimiterSettings, RateLimiter

SETTINGS = LimiterSettings(samples_per_insert=4.0, min_transitions=100, tolerance=50, largest_insert=20, batch_size=64)


def test_learning_waits_for_the_first_transitions() -> None:
    limiter = RateLimiter(SETTINGS)
    assert not limiter.may_sample(64)
    assert limiter.may_insert(99)
    assert not limiter.may_sample(64)
    assert "learning waits for min_transitions 100" in limiter.describe()
    assert limiter.may_insert(1)
    assert limiter.may_sample(64)
    assert (limiter.inserted, limiter.sampled) == (100, 64)


def test_sampling_stops_at_its_bound_and_one_insert_frees_it() -> None:
    limiter = RateLimiter(SETTINGS, inserted=100)
    batches = 0
    while limiter.may_sample(64):
        batches += 1
    assert batches == 3  # 4 * 50 = 200 samples ahead at most: 192
    assert "learning waits for the actors" in limiter.describe()
    assert limiter.may_insert(14)
    assert limiter.may_sample(64)  # 256 <= 4 * (14 + 50)
    assert not limiter.may_sample(1)


def test_inserting_stops_at_its_bound_and_one_batch_frees_it() -> None:
    limiter = RateLimiter(SETTINGS)
    assert limiter.may_insert(150)
    assert not limiter.may_insert(1)
    assert limiter.inserted == 150  # a refusal is not counted
    assert "actors wait for learning" in limiter.describe()
    assert limiter.may_sample(64)
    assert limiter.may_insert(16)
    assert not limiter.may_insert(1)


def test_in_turns_neither_side_ever_stops_and_the_ratio_holds() -> None:
    settings = LimiterSettings(3.7, 50, (20 + 64 / 3.7) / 2, 20, 64)  # as narrow as is allowed
    limiter = RateLimiter(settings, inserted=49)  # the next insert goes beyond min_transitions + tolerance
    for i in range(5000):
        assert limiter.may_sample(64) or limiter.may_insert(20 if i % 3 else 7) or limiter.may_insert(20)
    assert limiter.sampled / (limiter.inserted - 50) == pytest.approx(3.7, rel=0.01)


def test_a_failed_insert_gives_its_permission_back() -> None:
    limiter = RateLimiter(SETTINGS)
    assert limiter.may_insert(150)
    limiter.give_back(10)
    assert limiter.may_insert(10)


def test_open_lifts_both_bounds_but_never_samples_too_little_data() -> None:
    limiter = RateLimiter(SETTINGS)
    limiter.open()
    assert not limiter.may_sample(1)
    assert limiter.may_insert(10_000)
    assert limiter.may_sample(10**9)


def test_without_tolerance_limit_neither_waits() -> None:
    limiter = RateLimiter(LimiterSettings(4.0, 1, math.inf))
    assert limiter.may_insert(10**6)
    assert limiter.may_sample(10**9)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"samples_per_insert": 0.0}, "samples_per_insert: got 0.0; allowed above 0"),
        ({"min_transitions": 0}, "min_transitions: got 0; at least 1"),
        ({"tolerance": 17.9}, r"tolerance: got 17\.9 transitions; at least 18 = .* for ever"),
        ({"tolerance": math.nan}, "tolerance: got nan"),
    ],
)
def test_settings_that_would_stop_for_good_are_refused(change: dict, message: str) -> None:
    plain = {"samples_per_insert": 4.0, "min_transitions": 9, "tolerance": 18.0, "largest_insert": 20, "batch_size": 64}
    LimiterSettings(**plain)
    with pytest.raises(ValueError, match=message):
        LimiterSettings(**{**plain, **change})
