"""Random streams of a run: none in common between its parts, its actors, their lives, or neighbouring seeds."""

from __future__ import annotations

import itertools

from appl_dist import seeds
from appl_dist.learner.settings import TD3Settings
from appl_dist.learner.td3 import TD3


def test_no_two_streams_of_ten_seeds_are_in_the_same_state() -> None:
    lives = list(itertools.product(("actor-0", "actor-1", "actor-10"), (0, 1, 40), ("exploration", "environment")))
    names = [("learner", "td3"), ("learner", "replay"), *(("actor", *life) for life in lives)]
    numbers = [tuple(seeds.generator(seed, *name).integers(0, 2**63, 4)) for seed in range(10) for name in names]
    assert len(set(numbers)) == 10 * len(names)
    assert len({seeds.integer(seed, *name) for seed in range(10) for name in names}) == 10 * len(names)


def test_a_stream_is_the_same_in_every_process() -> None:
    assert seeds.integer(3, "actor", "a", 7, "environment") == seeds.integer(3, "actor", "a", 7, "environment")
    assert seeds.generator(0, "learner", "replay").integers(0, 1000) == 849


def test_target_noise_of_one_seed_is_not_the_weights_of_the_next() -> None:
    states = set()
    for seed in range(5):
        learner = TD3(TD3Settings(hidden=(8,)), 4, 2, seeds.stream(seed, "learner", "td3"))
        states.add(bytes(learner.noise.get_state().numpy().tobytes()))
        states.add(learner.policy_arrays()[0][0].tobytes())
    assert len(states) == 10
