"""The learner process in this one: numbers it writes, divergence, and going on where it stopped."""

from __future__ import annotations

import json
import logging
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

from appl_dist.errors import UserError
from appl_dist.learner.learner import Learner, _Every
from appl_dist.learner.run_info import Run
from appl_dist.learner.settings import LearnerSettings, TD3Settings
from appl_dist.planner.dwa import DWA
from appl_dist.spec import Rollout
from appl_dist.wire.codec import UploadHeader
from appl_dist.wire.memory import MemoryHub
from tests.paper_sizes import LAYOUT, OBSERVATION_SIZE

SETTINGS = LearnerSettings(
    TD3Settings(hidden=(16,), batch_size=8),
    replay_capacity=1000,
    min_transitions=10,
    publish_every_s=3600.0,
    report_every_s=3600.0,
    checkpoint_every_s=3600.0,
    detail_every=1,
    samples_per_insert=100.0,
)


def rollout(seed: int, world: int, success: bool) -> Rollout:
    rng = np.random.default_rng(seed)

    def uniform(*shape: int) -> np.ndarray:
        return rng.uniform(-1, 1, shape).astype(np.float32)

    info = {
        "world": world, "ended": True, "success": success, "time_s": 20.0, "return_": -3.0, "policy_version": 1,
        "policy_epoch": 1,
    }  # fmt: skip
    return Rollout(uniform(11, OBSERVATION_SIZE), uniform(10, 8), uniform(10), True, info, LAYOUT.scan_size)


def run_info(folder: Path, seed: int = 0) -> Run:
    return Run("run", folder, seed, 10**6, 0.0, {}, DWA, LAYOUT, 70.0, lambda _: 0.1)


@contextmanager
def learner(folder: Path, seed: int = 0) -> Iterator[Learner]:
    part = Learner(MemoryHub().connect(), run_info(folder, seed), SETTINGS)
    try:
        yield part
    finally:
        part.close()


def give(part: Learner, count: int = 3) -> None:
    for _ in range(count):
        seq = part.ingest.expected_seq("a")
        header = UploadHeader("run", "a", "i1", part.epoch, seq, 10)
        ack = part.server._sink.store(header, rollout(seq, world=seq % 2, success=seq != 2))
        assert ack.status == "stored"


def test_every_number_of_the_run_reaches_both_files(tmp_path: Path) -> None:
    with learner(tmp_path) as part:
        give(part)
        for _ in range(4):
            assert part.step()
        part.telemetry.write(part.version)
        part.save()
    records = [json.loads(line) for line in (tmp_path / "metrics.jsonl").read_text().splitlines()]
    found = {name: value for record in records for name, value in record.items()}
    wanted = {
        "loss/critic", "loss/actor", "q/mean", "q/std", "q/target_mean", "q/td_error", "norm/actor", "norm/critic",
        "norm/actor_gradient", "norm/critic_gradient", *(f"saturation/{name}" for name in DWA.names),
        "policy/staleness", "policy/version", "rate/samples_per_insert", "rate/updates_per_s", "episode/success",
        "episode/time_s", "world_success/0", "world_time_s/0", "world_success/1", "world_time_s/1",
    }  # fmt: skip
    assert wanted <= found.keys()
    assert found["rate/samples_per_insert"] == pytest.approx(4 * 8 / 30)
    assert (found["world_success/0"], found["world_time_s/0"]) == (0.5, 45.0)  # 20 s, and a failure's 70 s
    assert (found["world_success/1"], found["world_time_s/1"]) == (1.0, 20.0)
    events = EventAccumulator(str(tmp_path))
    events.Reload()
    assert wanted <= set(events.Tags()["scalars"])


def test_not_a_number_stops_the_run_and_names_the_last_good_checkpoint(tmp_path: Path) -> None:
    with learner(tmp_path) as part:
        give(part)
        part.step()
        part.save()
        part.checkpoints.wait()
        good = part.checkpoints.newest()
        part.td3.critic.q1.linears()[0].weight.data[0, 0] = torch.nan
        with pytest.raises(UserError, match=rf"training diverged: .* is nan; the last good checkpoint is {good}"):
            part.step()
        part.td3.actor.mlp.linears()[0].weight.data[0, 0] = torch.inf
        for action in (part._publish, part.end):  # nothing that is not finite is ever sent or kept
            with pytest.raises(Exception, match="not finite"):
                action()
    assert good is not None and good.exists()
    with learner(tmp_path) as part:
        assert part.td3.updates == 1
        assert all(torch.isfinite(p).all() for p in part.td3.critic.parameters())
        assert part.step()


def test_a_policy_is_published_at_the_start_and_then_only_when_it_has_changed(tmp_path: Path) -> None:
    with learner(tmp_path) as part:
        part._publishing = _Every(0.0)  # due at every step
        part.step()  # too few transitions to learn from
        part.step()
        assert part.version == 1
        give(part)
        assert part.step()
        assert part.step()
        assert part.version == 3
        part.save()
        part.checkpoints.wait()
    with learner(tmp_path) as part:  # a new process says so, with the weights of the old one
        assert (part.epoch, part.version) == (2, 4)


def numbers(part: Learner) -> torch.Tensor:
    tensors, _ = part.td3.state()
    return torch.cat([tensor.flatten().double() for tensor in tensors.values()])


def test_a_run_that_stopped_and_went_on_equals_one_that_never_stopped(tmp_path: Path) -> None:
    with learner(tmp_path / "stays") as stays:
        give(stays)
        for _ in range(6):
            assert stays.step()
        wanted = numbers(stays)
    with learner(tmp_path / "stops") as first:
        give(first)
        for _ in range(3):
            first.step()
        first.save()
    with learner(tmp_path / "stops", seed=0) as second:
        for _ in range(3):
            assert second.step()
        found = numbers(second)
    assert torch.equal(found, wanted)


@pytest.mark.parametrize(
    "extra", [{"version": 3}, {"version": 3, "elapsed_s": "long"}, {"version": 3, "elapsed_s": -1.0}]
)
def test_a_checkpoint_without_what_a_restart_needs_is_refused_in_one_sentence(
    tmp_path: Path, extra: dict[str, object]
) -> None:
    with learner(tmp_path) as part:
        part.checkpoints.save(part.td3, part.rng, {"version": 3, **extra})
        part.checkpoints.wait()
        path = part.checkpoints.newest()
    with pytest.raises(UserError, match=rf"{path}: elapsed_s: got .*; a number, 0 or more"), learner(tmp_path):
        pass


def test_a_damaged_epoch_file_is_refused_in_one_sentence(tmp_path: Path) -> None:
    with learner(tmp_path):
        pass
    (tmp_path / "epoch.json").write_text("{")
    with pytest.raises(UserError, match=r"epoch\.json: epoch: got None"), learner(tmp_path):
        pass


def test_a_run_that_its_minutes_end_says_so_and_how_to_go_on(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    part = Learner(MemoryHub().connect(), replace(run_info(tmp_path), minutes=1e-9), SETTINGS)
    try:
        with caplog.at_level(logging.WARNING):
            part.run(lambda: False)
    finally:
        part.close()
    assert "run.minutes=1e-09 ended training before run.transitions=1000000; run.resume=" in caplog.text
