from __future__ import annotations

import numpy as np
import pytest

from appl_dist.learner.replay import Replay
from appl_dist.learner.sum_tree import BETA, EPSILON, Priorities
from tests.unit.learner.helpers import ACT, OBS, SCAN, rollout


def shares(rows: np.ndarray, count: int) -> np.ndarray:
    return np.bincount(rows, minlength=count) / len(rows)


def test_rows_are_drawn_in_proportion_and_weighted_against_it() -> None:
    priorities = Priorities(5, alpha=0.5)
    priorities.enter(0, 4)
    priorities.update(np.arange(4), np.array([1, 4, 9, 16], np.float32) - np.float32(EPSILON))
    rows, weights = priorities.draw(100_000, 4, np.random.default_rng(0))
    np.testing.assert_allclose(shares(rows, 5), [0.1, 0.2, 0.3, 0.4, 0.0], atol=1e-4)  # |error| to the 0.5
    wanted = (np.array([1, 2, 3, 4]) / 1.0) ** -BETA  # against the rarest
    np.testing.assert_allclose(weights, wanted[rows], rtol=1e-4)


def test_new_rows_are_as_likely_as_the_likeliest_and_left_rows_never_come_back() -> None:
    priorities = Priorities(8, alpha=1.0)
    priorities.enter(0, 2)
    priorities.update(np.array([0]), np.array([3.0 - EPSILON], np.float32))
    priorities.enter(6, 1)
    priorities.leave(1, 1)
    priorities.update(np.array([1, 6]), np.array([100.0, 3.0 - EPSILON], np.float32))  # sampled before 1 left
    rows, _ = priorities.draw(10_000, 2, np.random.default_rng(0))
    np.testing.assert_allclose(shares(rows, 8), [0.5, 0, 0, 0, 0, 0, 0.5, 0], atol=1e-3)


@pytest.mark.parametrize("capacity", [16, 40])
def test_a_ring_draws_only_stored_transitions(capacity: int) -> None:
    def small(exponent: float) -> Replay:
        return Replay(
            None, capacity, 3, 1.0, observation_size=OBS, scan_size=SCAN, action_size=ACT, priority_exponent=exponent
        )

    uniform, prioritised = small(0.0), small(0.6)
    rng = np.random.default_rng(0)
    for seq in range(60):
        n = int(rng.integers(1, 9))
        for replay in (uniform, prioritised):
            replay.ring.insert(rollout(100 * seq, n, rewards=np.ones(n)), "a", seq)
        batch = prioritised.sample(400, rng)
        assert batch.rows is not None
        steps = batch.next_observations[:, 2] - batch.observations[:, 2]
        np.testing.assert_array_equal(steps, batch.returns)
        stored = np.unique(uniform.sample(2000, rng).observations[:, 2])
        assert np.isin(batch.observations[:, 2], stored).all()
        prioritised.prioritise(batch.rows, rng.random(400).astype(np.float32))
    assert uniform.sample(5, rng).weights is None


def test_a_reopened_replay_starts_with_equal_priorities(tmp_path) -> None:
    def reopen() -> Replay:
        return Replay(
            tmp_path, 30, 1, 0.9, observation_size=OBS, scan_size=SCAN, action_size=ACT, priority_exponent=0.6
        )

    with reopen() as replay:
        for seq in range(9):
            replay.ring.insert(rollout(10 * seq, 4), "a", seq)
    with reopen() as replay:
        batch = replay.sample(4000, np.random.default_rng(0))
        _, counts = np.unique(batch.observations[:, 2], return_counts=True)
        assert len(counts) == len(replay.ring)
        assert counts.max() - counts.min() <= 2
        assert batch.weights is not None and (batch.weights == 1.0).all()
