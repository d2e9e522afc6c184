"""The ring against the plainest model of it: a list of rollouts."""

from __future__ import annotations

import tempfile

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from appl_dist.spec import Rollout
from tests.unit.learner.helpers import rollout, small_replay

CAPACITY, GAMMA = 24, 0.9


def expected(stored: list[Rollout], n_step: int) -> dict[float, tuple[float, float, float]]:
    """Step number -> return, discount, next number, by the definition."""
    rows = {}
    for r in stored:
        for t in range(len(r)):
            k = min(n_step, len(r) - t)
            value = sum(GAMMA**i * float(r.rewards[t + i]) for i in range(k))
            discount = 0.0 if r.terminal and t + k == len(r) else GAMMA**k
            rows[float(r.observations[t, 2])] = (value, discount, float(r.observations[t + k, 2]))
    return rows


@settings(max_examples=60, deadline=None)
@given(
    lengths=st.lists(st.tuples(st.integers(1, CAPACITY), st.booleans()), min_size=1, max_size=25),
    n_step=st.integers(1, 5),
    reopen=st.booleans(),
)
def test_the_ring_holds_the_newest_rollouts_and_their_n_step_targets(
    lengths: list[tuple[int, bool]], n_step: int, reopen: bool
) -> None:
    with tempfile.TemporaryDirectory() as folder:
        replay = small_replay(folder if reopen else None, CAPACITY, n_step, GAMMA)
        inserted: list[Rollout] = []
        for seq, (n, terminal) in enumerate(lengths):
            r = rollout(1000 * seq, n, terminal, rewards=np.linspace(-1, 1, n))
            replay.ring.insert(r, "a", seq)
            inserted.append(r)
            if reopen:
                replay.close()
                replay = small_replay(folder, CAPACITY, n_step, GAMMA)
            # What is held is the newest rollouts, whole, as many as fit: at least the last one.
            held: list[Rollout] = []
            while sum(map(len, held)) < len(replay.ring):
                held.append(inserted[-1 - len(held)])
            assert sum(map(len, held)) == len(replay.ring) <= CAPACITY
            assert held
        batch = replay.sample(600, np.random.default_rng(0))
        wanted = expected(held, n_step)
        found = set(batch.observations[:, 2].tolist())
        assert found <= set(wanted)
        for i, number in enumerate(batch.observations[:, 2].tolist()):
            value, discount, following = wanted[number]
            assert abs(batch.returns[i] - value) < 1e-5
            assert abs(batch.discounts[i] - discount) < 1e-6
            assert batch.next_observations[i, 2] == following
        replay.close()


@settings(max_examples=30, deadline=None)
@given(lengths=st.lists(st.integers(16, CAPACITY), min_size=1, max_size=12))
def test_with_long_rollouts_the_ring_is_filled_as_far_as_whole_rollouts_allow(lengths: list[int]) -> None:
    replay = small_replay(None, 10 * CAPACITY)
    for seq, n in enumerate(lengths):
        replay.ring.insert(rollout(0, n), "a", seq)
    kept = 0
    for n in reversed(lengths):
        if kept + n > 10 * CAPACITY:
            break
        kept += n
    # The end of a lap may stay empty by less than one rollout.
    assert kept - CAPACITY <= len(replay.ring) <= kept
