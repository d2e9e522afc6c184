from dataclasses import replace

import numpy as np
import pytest

from appl_dist.actor.exploration import ExplorationSettings, explore

PAPER = ExplorationSettings(uniform_fraction=0.0, horizon=5_000_000)
SHORT = replace(PAPER, horizon=100)


def test_schedule_is_the_papers_at_five_million_transitions() -> None:
    # 0.5 at the start, 0.125 less a million, floor 0.02 from 3.84 million on.
    for millions, sigma in ((0, 0.5), (1, 0.375), (2, 0.25), (3.84, 0.02), (5, 0.02)):
        assert PAPER.sigma(int(millions * 1e6)) == pytest.approx(sigma, abs=1e-3)


def test_schedule_scales_with_the_run() -> None:
    assert replace(PAPER, horizon=50_000).sigma(10_000) == pytest.approx(PAPER.sigma(1_000_000))


def test_fault_01_noise_reaches_the_executed_action() -> None:
    rng = np.random.default_rng(0)
    action = np.zeros(8, np.float32)
    noisy = np.stack([explore(action, SHORT, 0, rng) for _ in range(2000)])
    assert noisy.std() == pytest.approx(0.5, rel=0.1)
    assert abs(noisy.mean()) < 0.02


def test_actions_stay_in_the_box() -> None:
    rng = np.random.default_rng(0)
    noisy = np.stack([explore(np.ones(8, np.float32), SHORT, 0, rng) for _ in range(500)])
    assert noisy.max() == 1.0
    assert noisy.min() >= -1.0
    assert noisy.dtype == np.float32


def test_the_run_starts_with_uniform_actions() -> None:
    settings = ExplorationSettings(uniform_fraction=0.1, horizon=100)
    rng = np.random.default_rng(0)
    action = np.full(8, 0.9, np.float32)
    early = np.stack([explore(action, settings, 9, rng) for _ in range(500)])
    assert abs(early.mean()) < 0.05
    late = np.stack([explore(action, settings, 100, rng) for _ in range(500)])
    assert late.mean() == pytest.approx(0.9, abs=0.01)


def test_a_floor_above_the_start_is_refused() -> None:
    with pytest.raises(ValueError, match=r"explore\.sigma_floor: got 0\.6; allowed at most"):
        ExplorationSettings(sigma_floor=0.6)
