"""A run that starts from another: its networks, none of its counts."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest
import torch

from appl_dist.errors import UserError
from appl_dist.learner.initial import LEARNED
from appl_dist.learner.learner import Learner
from appl_dist.wire.memory import MemoryHub
from tests.unit.learner.test_learner import SETTINGS, give, learner, run_info


def started(folder: Path, init: Path) -> Learner:
    return Learner(MemoryHub().connect(), run_info(folder, 9), replace(SETTINGS, init=str(init)))


@pytest.fixture
def trained(tmp_path: Path) -> Path:
    with learner(tmp_path / "first") as part:
        give(part)
        for _ in range(4):
            assert part.step()
        part.save()
        part.checkpoints.wait()
    return tmp_path / "first"


def test_a_run_gives_its_networks_targets_and_optimisers(trained: Path, tmp_path: Path) -> None:
    with learner(trained) as first:
        wanted, _ = first.td3.state()
    second = started(tmp_path / "second", trained)
    found, numbers = second.td3.state()
    assert numbers["updates"] == 0 and second.replay.ring.transitions_total == 0
    for name, tensor in wanted.items():
        assert torch.equal(found[name], tensor) == name.startswith(LEARNED), name
    second.close()


def test_a_policy_file_gives_the_actor_alone(trained: Path, tmp_path: Path) -> None:
    with learner(trained) as first:
        wanted, _ = first.td3.state()
    second = started(tmp_path / "second", trained / "policy.safetensors")
    found, _ = second.td3.state()
    assert torch.equal(found["actor.mlp.layers.0.weight"], wanted["actor.mlp.layers.0.weight"])
    assert torch.equal(found["actor_target.mlp.layers.0.weight"], wanted["actor.mlp.layers.0.weight"])
    assert not torch.equal(found["critic.q1.layers.0.weight"], wanted["critic.q1.layers.0.weight"])
    second.close()


def test_what_does_not_fit_is_named(trained: Path, tmp_path: Path) -> None:
    wider = replace(SETTINGS, init=str(trained), td3=replace(SETTINGS.td3, hidden=(17,)))
    with pytest.raises(UserError, match=r"learner\.init: .*layers\.0\.\w+ has shape .* there, this run asks for"):
        Learner(MemoryHub().connect(), run_info(tmp_path / "second"), wider)
    for source, sentence in ((tmp_path / "none", "cannot read policy file"), (tmp_path, "holds no checkpoint")):
        with pytest.raises(UserError, match=sentence):
            started(tmp_path / sentence.replace(" ", "-"), source)
