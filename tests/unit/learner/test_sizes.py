"""Another lidar and another number of parameters, from the environment to the evaluation of what was learned."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from appl_dist.actor.env import NavigationEnv
from appl_dist.actor.protocol import PROTOCOLS
from appl_dist.actor.rollout import collect, run_episode
from appl_dist.errors import UserError
from appl_dist.learner.learner import Learner
from appl_dist.learner.run_info import Run
from appl_dist.learner.settings import LearnerSettings, TD3Settings
from appl_dist.planner.dwa import DWA
from appl_dist.policy.load import load_policy
from appl_dist.policy.observation import PAPER, layout_of
from appl_dist.sim.generate import generate_worlds
from appl_dist.sim.robot import LidarSettings
from appl_dist.spec import ParameterSpace, Rollout
from appl_dist.wire import receipt
from appl_dist.wire.codec import UploadHeader, decode_rollout, encode_rollout
from appl_dist.wire.memory import MemoryHub

BEAMS = 96
SPEEDS = ParameterSpace("speeds", "dwa", DWA.parameters[:3])
SIZE = BEAMS + 1 + 3


@pytest.fixture(scope="module")
def env() -> NavigationEnv:
    protocol = replace(PROTOCOLS.get("appl"), limit_s=6.0)
    lidar = LidarSettings(beams=BEAMS)
    return NavigationEnv(generate_worlds(1, 0), protocol=protocol, space=SPEEDS, lidar=lidar)


def small_learner(folder: Path, env: NavigationEnv) -> Learner:
    run = Run("run", folder, 0, 10**6, 0.0, {}, SPEEDS, env.observation_builder.layout, 70.0, lambda _: 0.1)
    td3 = TD3Settings(hidden=(8,), batch_size=4, precision="fp32")
    settings = LearnerSettings(replay_capacity=1000, min_transitions=1, samples_per_insert=100.0, td3=td3)
    return Learner(MemoryHub().connect(), run, settings)


def test_nothing_assumes_a_lidar_or_a_number_of_parameters(env: NavigationEnv, tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    rollout = collect(env, lambda _: rng.uniform(-1, 1, len(SPEEDS)).astype(np.float32), seed=0)
    assert rollout is not None
    assert (rollout.observations.shape[1], rollout.actions.shape[1]) == (SIZE, 3)
    blob = encode_rollout(rollout)
    received = decode_rollout(blob)
    np.testing.assert_array_equal(received.observations[:, BEAMS:], rollout.observations[:, BEAMS:])
    kept = (received.observations[:, BEAMS:], received.actions, received.rewards)
    assert receipt.of_blob(blob) == receipt.of_arrays(*kept)

    learner = small_learner(tmp_path, env)
    assert learner.server._sink.store(UploadHeader("run", "a", "i", 1, 0, len(received)), received).status == "stored"
    assert learner.step()
    learner.save()
    learner.close()
    policy = load_policy(str(tmp_path / "policy.safetensors"), SPEEDS, env.observation_builder.layout)
    assert run_episode(env, policy, seed=1, world=0).parameters.shape[1] == 3
    with pytest.raises(UserError, match=r"made for ObservationLayout.*scan_size=96.*this run has .*scan_size=720"):
        load_policy(str(tmp_path / "policy.safetensors"), SPEEDS, layout_of(PAPER, 720, SPEEDS))


def test_a_rollout_of_another_robot_is_refused(env: NavigationEnv, tmp_path: Path) -> None:
    learner = small_learner(tmp_path, env)
    zeros = np.zeros((3, SIZE + 1), np.float32)
    alien = Rollout(zeros, np.zeros((2, 3), np.float32), np.zeros(2, np.float32), False, {}, BEAMS)
    with pytest.raises(ValueError, match=r"got \(101, 96, 3\); this run has \(100, 96, 3\)"):
        learner.server._sink.store(UploadHeader("run", "a", "i", 1, 0, 2), alien)
    learner.close()


def test_a_space_holds_parameters_of_its_planner() -> None:
    other = ParameterSpace("other", "dwa", (replace(DWA.parameters[0], name="warp"),))
    with pytest.raises(ValueError, match="space 'other': warp: no parameter of the planner dwa"):
        NavigationEnv(generate_worlds(1, 0), space=other)
