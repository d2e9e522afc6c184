from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from appl_dist.errors import UserError
from appl_dist.learner import checkpoint
from appl_dist.learner.checkpoint import Checkpoints
from appl_dist.learner.replay import Replay
from appl_dist.learner.settings import TD3Settings
from appl_dist.learner.td3 import TD3, Diverged
from tests.unit.learner.helpers import ACT, OBS, rollout, small_replay

SMALL = TD3Settings(hidden=(16, 16), batch_size=32)


def fill(replay: Replay) -> Replay:
    for seq in range(5):
        replay.ring.insert(rollout(10 * seq, 8, seq % 2 == 0), "a", seq)
    return replay


def train(learner: TD3, replay: Replay, rng: np.random.Generator, updates: int) -> None:
    for _ in range(updates):
        learner.update(replay.sample(32, rng))


def numbers(learner: TD3) -> torch.Tensor:
    tensors, _ = learner.state()
    return torch.cat([t.flatten().double() for t in tensors.values()])


@pytest.mark.parametrize("precision", ["fp32", "bf16"])
def test_resuming_equals_never_stopping_bit_for_bit(tmp_path: Path, precision: str) -> None:
    settings = dataclasses.replace(SMALL, precision=precision)
    replay = fill(small_replay(tmp_path / "replay"))
    stays, rng = TD3(settings, OBS, ACT, seed=1), np.random.default_rng(5)
    train(stays, replay, rng, 7)  # odd: in the middle of the policy delay
    checkpoints = Checkpoints(tmp_path)
    checkpoints.save(stays, rng, {"version": 3})
    train(stays, replay, rng, 8)  # while it is written
    checkpoints.close()
    replay.close()

    resumed, other = TD3(settings, OBS, ACT, seed=99), np.random.default_rng(99)
    assert Checkpoints(tmp_path).load(resumed, other) == {"version": 3}
    assert resumed.updates == 7
    train(resumed, small_replay(tmp_path / "replay"), other, 8)
    assert torch.equal(numbers(resumed), numbers(stays))
    assert other.bit_generator.state == rng.bit_generator.state


def test_an_untrained_learner_can_be_saved_and_loaded(tmp_path: Path) -> None:
    learner, rng = TD3(SMALL, OBS, ACT, seed=1), np.random.default_rng(0)
    checkpoints = Checkpoints(tmp_path)
    assert checkpoints.load(learner, rng) is None
    assert checkpoints.newest() is None
    checkpoints.save(learner, rng, {})
    checkpoints.wait()
    other = TD3(SMALL, OBS, ACT, seed=2)
    checkpoints.load(other, rng)
    replay = fill(small_replay())
    train(learner, replay, np.random.default_rng(0), 4)
    train(other, replay, np.random.default_rng(0), 4)
    assert torch.equal(numbers(learner), numbers(other))


def test_the_newest_two_are_kept(tmp_path: Path) -> None:
    learner, rng = TD3(SMALL, OBS, ACT), np.random.default_rng(0)
    (tmp_path / "checkpoint-0000000001.tmp").write_bytes(b"left by a kill")
    checkpoints = Checkpoints(tmp_path, keep=2)
    for updates in (5, 20, 100):
        learner.updates = updates
        checkpoints.save(learner, rng, {})
    checkpoints.close()
    names = [f"checkpoint-{u:010d}.safetensors" for u in (20, 100)]
    assert sorted(p.name for p in tmp_path.iterdir()) == names
    assert checkpoints.newest() == tmp_path / names[1]


def test_a_diverged_learner_does_not_replace_a_good_checkpoint(tmp_path: Path) -> None:
    learner, rng = TD3(SMALL, OBS, ACT), np.random.default_rng(0)
    checkpoints = Checkpoints(tmp_path, keep=1)
    checkpoints.save(learner, rng, {})
    checkpoints.wait()
    good = checkpoints.newest()
    learner.updates = 1
    learner.actor.mlp.linears()[0].weight.data[0, 0] = torch.nan
    checkpoints.save(learner, rng, {})
    with pytest.raises(Diverged, match=r"actor\.mlp\.layers\.0\.weight holds a value that is not finite"):
        checkpoints.wait()
    assert checkpoints.newest() == good


def test_a_write_that_fails_is_told_and_leaves_the_last(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    learner, rng = TD3(SMALL, OBS, ACT), np.random.default_rng(0)
    checkpoints = Checkpoints(tmp_path)
    checkpoints.save(learner, rng, {})
    checkpoints.wait()

    def full(*_: Any) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(checkpoint, "save_file", full)
    learner.updates = 9
    checkpoints.save(learner, rng, {})
    with pytest.raises(
        UserError, match=r"0009\.safetensors: cannot be written: .*No space.*good checkpoint is .*0000\."
    ):
        checkpoints.close()


def test_damaged_and_foreign_files_are_refused_in_a_sentence(tmp_path: Path) -> None:
    learner, rng = TD3(SMALL, OBS, ACT), np.random.default_rng(0)
    checkpoints = Checkpoints(tmp_path)
    checkpoints.save(learner, rng, {})
    checkpoints.wait()
    path = checkpoints.newest()
    assert path is not None
    with pytest.raises(UserError, match=r"does not fit this run: networks: actor\.mlp\.layers\.0\.bias has shape"):
        checkpoints.load(TD3(dataclasses.replace(SMALL, hidden=(8,)), OBS, ACT), rng)
    path.write_bytes(path.read_bytes()[:-100])
    with pytest.raises(UserError, match="not a usable checkpoint"):
        checkpoints.load(learner, rng)
    path.write_bytes(b"")
    with pytest.raises(UserError, match="not a usable checkpoint"):
        checkpoints.load(learner, rng)
    with pytest.raises(UserError, match=r"none\.safetensors: cannot be read"):
        checkpoint.load(tmp_path / "none.safetensors")
