"""The actor's loop with the real environment and spool, and weights that change under it."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from appl_dist.actor.collect import Explorer, act
from appl_dist.actor.env import NavigationEnv
from appl_dist.actor.exploration import ExplorationSettings
from appl_dist.actor.protocol import PROTOCOLS
from appl_dist.actor.spool import Spool
from appl_dist.planner.dwa import DWA
from appl_dist.policy_file import PolicyFile
from appl_dist.sim.generate import generate_worlds
from appl_dist.wire.codec import decode_rollout
from appl_dist.wire.run_status import Progress
from tests.paper_sizes import LAYOUT, OBSERVATION_SIZE

SILENT = ExplorationSettings(sigma_start=0.0, sigma_floor=0.0, uniform_fraction=0.0)


class Constant:
    """Weights of a policy that always gives the same action: `version` tenths."""

    def __init__(self) -> None:
        self.version = 1
        self.asked = 0

    def latest(self) -> tuple[int, int, bytes]:
        self.asked += 1
        bias = np.full(8, np.arctanh(self.version / 10.0), np.float32)
        weights = (np.zeros((8, OBSERVATION_SIZE), np.float32),)
        return (
            1,
            self.version,
            PolicyFile(weights, (bias,), space=DWA, observation=LAYOUT, epoch=1, version=self.version).to_bytes(),
        )


@pytest.fixture
def env() -> Iterator[NavigationEnv]:
    env = NavigationEnv(generate_worlds(3, 0), protocol=replace(PROTOCOLS.get("appl"), limit_s=6.0))
    yield env
    env.close()


def run(env: NavigationEnv, weights: Any, spool: Spool, decisions: int, seed: int = 0) -> int:
    explorer = Explorer(weights, env, SILENT, np.random.default_rng(seed))
    beats: list[Progress] = []
    made = act(env, explorer, spool, seed=seed, stop=lambda: len(beats) >= decisions, beat=beats.append)
    assert [b.transitions for b in beats] == list(range(1, len(beats) + 1))
    return made


def test_fault_07_every_episode_is_kept_under_its_own_number(env: NavigationEnv, tmp_path: Path) -> None:
    with Spool(tmp_path, "run/actor", 100, 1 << 24) as spool:
        made = run(env, Constant(), spool, 40)
        count = len(spool)
        assert count > 10  # the published code dropped trajectories past ten
        stored = []
        for k in range(count):
            head = spool.peek(timeout_s=0.0)
            assert head is not None
            seq, blob = head
            assert seq == k
            stored.append(decode_rollout(blob))
            spool.ack(seq)
    assert sum(len(r) for r in stored) == made


def test_fault_11_new_weights_are_used_from_the_next_decision_on(env: NavigationEnv, tmp_path: Path) -> None:
    weights = Constant()

    class Changing:
        def latest(self) -> tuple[int, int, bytes]:
            weights.version = 1 + weights.asked  # newer at every question
            return weights.latest()

    with Spool(tmp_path, "run/actor", 100, 1 << 24) as spool:
        run(env, Changing(), spool, 3)
        head = spool.peek(timeout_s=0.0)
        assert head is not None
        rollout = decode_rollout(head[1])
    assert rollout.actions[:, 0] == pytest.approx([0.1, 0.2, 0.3], abs=1e-3)


def test_weights_of_another_space_are_ignored_and_the_old_policy_goes_on(env: NavigationEnv, tmp_path: Path) -> None:
    good = Constant()

    class Broken:
        calls = 0

        def latest(self) -> tuple[int, int, bytes]:
            self.calls += 1
            return good.latest() if self.calls == 1 else (1, 2, b"not a policy")

    with Spool(tmp_path, "run/actor", 100, 1 << 24) as spool:
        run(env, Broken(), spool, 3)
        head = spool.peek(timeout_s=0.0)
        assert head is not None
        assert decode_rollout(head[1]).actions[:, 0] == pytest.approx([0.1] * 3, abs=1e-3)


def test_a_stop_ends_an_actor_whose_spool_is_full_and_keeps_its_episode(env: NavigationEnv, tmp_path: Path) -> None:
    with Spool(tmp_path, "run/actor", 1, 1 << 24) as spool:
        explorer = Explorer(Constant(), env, SILENT, np.random.default_rng(0))
        beats: list[Progress] = []

        def stop() -> bool:
            return bool(beats) and beats[-1].pending == 1 and beats[-1].world == -1

        act(env, explorer, spool, seed=0, stop=stop, beat=beats.append)
        assert len(spool) == 2
        assert spool.produced == beats[-1].transitions
