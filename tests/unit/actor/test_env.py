"""The environment on generated worlds: gymnasium's own checker, stable-baselines3, and the published faults."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env

from appl_dist.actor.env import NavigationEnv
from appl_dist.actor.protocol import PROTOCOLS
from appl_dist.actor.rollout import collect, run_episode
from appl_dist.planner.dwa import DWA
from appl_dist.policy.fixed import default_policy
from appl_dist.policy.load import load_policy
from appl_dist.sim.generate import generate_worlds
from appl_dist.sim.worlds import World
from tests.paper_sizes import LAYOUT, LIDAR_BEAMS

SHORT = replace(PROTOCOLS.get("appl"), limit_s=6.0)


@pytest.fixture(scope="module")
def worlds() -> list[World]:
    return generate_worlds(4, 0)


@pytest.fixture
def env(worlds: list[World]) -> Iterator[NavigationEnv]:
    env = NavigationEnv(worlds)
    yield env
    env.close()


@pytest.fixture
def short(worlds: list[World]) -> Iterator[NavigationEnv]:
    env = NavigationEnv(worlds, protocol=SHORT)
    yield env
    env.close()


def test_passes_gymnasiums_checker(short: NavigationEnv) -> None:
    check_env(short, skip_render_check=True)


def test_stable_baselines3_trains_in_it_unchanged(short: NavigationEnv) -> None:
    from stable_baselines3 import TD3

    model = TD3("MlpPolicy", short, learning_starts=100, batch_size=32, policy_kwargs={"net_arch": [32]}, seed=0)
    before = [p.detach().clone() for p in model.actor.parameters()]
    model.learn(250)
    assert model.num_timesteps == 250
    assert any((a != b).any() for a, b in zip(before, model.actor.parameters(), strict=True))


def test_observation_layout(env: NavigationEnv) -> None:
    first, _ = env.reset(seed=1, options={"world": 0})
    assert first[LIDAR_BEAMS + 1 :] == pytest.approx(DWA.to_action(DWA.defaults))
    assert first[LIDAR_BEAMS] == 0.0  # no plan yet
    action = np.linspace(-0.9, 0.9, 8, dtype=np.float32)
    observation, _, _, _, info = env.step(action)
    scan = np.clip(env.loop.scan, 0.0, 2.0) - 1.0
    assert observation[:LIDAR_BEAMS] == pytest.approx(scan, abs=1e-6)
    assert info["parameters"] == pytest.approx(DWA.to_values(action))
    assert observation[LIDAR_BEAMS + 1 :] == pytest.approx(DWA.to_action(info["parameters"]), abs=1e-6)
    assert 0.0 < abs(observation[LIDAR_BEAMS]) < 0.5  # a plan ahead of the robot, never exactly straight


def test_the_default_parameters_drive_to_the_goal(env: NavigationEnv) -> None:
    result = run_episode(env, default_policy(DWA), seed=3, world=0)
    assert result.success
    assert 8.0 < result.time_s < 50.0
    assert result.distance_m > 5.5  # 5.9 m from the start to y = 10
    assert result.decisions == math.ceil(result.time_s / 2.0)


def test_time_is_to_the_goal_and_not_to_the_end_of_the_decision(env: NavigationEnv) -> None:
    result = run_episode(env, default_policy(DWA), seed=3, world=0)
    assert result.time_s % 2.0 != 0.0


def test_same_seed_same_episode_whatever_ran_before(worlds: list[World]) -> None:
    def run(env: NavigationEnv) -> tuple[np.ndarray, np.ndarray]:
        rng = np.random.default_rng(5)
        rollout = collect(env, lambda _: rng.uniform(-1, 1, 8).astype(np.float32), seed=11, world=1)
        assert rollout is not None
        return rollout.observations, rollout.rewards

    fresh, used = NavigationEnv(worlds), NavigationEnv(worlds)
    run_episode(used, load_policy("set:max_vel_x=2.0", DWA, LAYOUT), seed=1, world=2)
    for a, b in zip(run(fresh), run(used), strict=True):
        assert np.array_equal(a, b)
    fresh.close()
    used.close()


def test_fault_04_max_vel_theta_bounds_turns_to_both_sides(env: NavigationEnv) -> None:
    env.reset(seed=0)
    slow = DWA.defaults
    slow[DWA.names.index("max_vel_theta")] = 0.4
    env.loop.planner.set_parameters(slow)
    env.loop.advance(1000)
    pose = env.loop.estimate[0]
    # Turned fully around, the robot must rotate; whatever the side, no faster than the new bound.
    for yaw in (-math.pi / 2, 0.0, math.pi):
        turned = np.array([pose[0], pose[1], yaw])
        env.loop.planner.plan(turned)
        for _ in range(40):
            command = env.loop.planner.control(turned, np.zeros(2), 2.0)
            assert abs(command[1]) <= 0.4 + 1e-9


def test_fault_05_a_time_limit_truncates_and_does_not_terminate(short: NavigationEnv) -> None:
    rollout = collect(short, lambda _: -np.ones(8, np.float32), seed=0, world=0)
    assert rollout is not None
    assert not rollout.terminal
    assert not rollout.info["success"]
    assert rollout.info["time_s"] == pytest.approx(6.0, abs=0.03)
    assert len(rollout) == 3


def test_fault_06_actions_are_stored_as_executed(short: NavigationEnv) -> None:
    rollout = collect(short, lambda _: np.full(8, 7.0, np.float32), seed=0, world=0)
    assert rollout is not None
    assert rollout.actions.max() == 1.0
    rollout.check()


def test_fault_08_every_world_is_visited_once_before_any_again(worlds: list[World]) -> None:
    env = NavigationEnv(worlds)
    env.reset(seed=9)
    order = [env.next_world() for _ in range(3 * len(worlds) - 1)]  # reset() took the first
    first = [env.world.index, *order]
    for k in range(3):
        assert sorted(first[k * 4 : (k + 1) * 4]) == [0, 1, 2, 3]
    env.close()


def test_fault_09_a_decision_lasts_its_period_exactly(env: NavigationEnv) -> None:
    env.reset(seed=0, options={"world": 0})
    for k in range(1, 4):
        _, _, terminated, truncated, info = env.step(np.full(8, (-1.0) ** k, np.float32))
        assert not (terminated or truncated)
        assert info["time_s"] == 2.0 * k


def test_fault_12_the_reference_path_lies_between_the_cylinders(worlds: list[World]) -> None:
    for world in worlds:
        gaps = np.hypot(*(world.path[:, None, :] - world.cylinders[None, :, :2]).transpose(2, 0, 1))
        assert (gaps - world.cylinders[:, 2]).min() > 0.37


def test_an_unknown_world_is_named(env: NavigationEnv) -> None:
    with pytest.raises(ValueError, match=r"options\.world: got 77"):
        env.reset(options={"world": 77})
