"""The same world, seed and parameters give the same episode, bit for bit, in any process, whatever ran before."""

from __future__ import annotations

import hashlib
import json
import os
import random
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from appl_dist.actor.env import NavigationEnv
from appl_dist.actor.protocol import PROTOCOLS
from appl_dist.planner.planner_settings import Arithmetic, PlannerSettings
from appl_dist.sim.generate import generate_worlds

EPISODES = 50
WORLDS = generate_worlds(10, seed=5)


def episode(env: NavigationEnv, number: int) -> tuple[str, bool]:
    """Digest of all that an episode yields, and whether it touched something.

    Two decisions of the planner under random parameters, then the robot is driven blindly until it has hit something
    in most worlds: what contacts do must repeat as well.
    """
    rng = np.random.default_rng([number, 77])
    digest = hashlib.sha256()
    observation, _ = env.reset(seed=number, options={"world": number % len(WORLDS)})
    for _ in range(2):
        digest.update(observation.tobytes())
        observation, reward, terminated, truncated, info = env.step(rng.uniform(-1, 1, 8).astype(np.float32))
        digest.update(np.array([reward, terminated, truncated, info["time_s"], info["min_clearance_m"]]).tobytes())
        if terminated or truncated:
            break
    simulator = env.loop.simulator
    for _ in range(60):
        simulator.step((rng.uniform(0.0, 2.0), rng.uniform(-1.5, 1.5)), 0.001 * int(rng.integers(10, 200)))
        for array in (simulator.pose, simulator.twist, simulator.odom_pose, simulator.odom_twist):
            digest.update(array.tobytes())
        digest.update(np.array([simulator.tilt_rad, simulator.in_collision, simulator.clearance_m]).tobytes())
    digest.update(simulator.scan().tobytes())
    return digest.hexdigest(), simulator.collided


def run(history: str, arithmetic: Arithmetic) -> list[tuple[str, bool]]:
    """All episodes; "plain" in order, "used" backwards, in a process that did other things before and between."""
    env = NavigationEnv(WORLDS, planner=PlannerSettings(arithmetic=arithmetic))
    if history == "plain":
        return [episode(env, k) for k in range(EPISODES)]
    np.random.seed(1)  # noqa: NPY002
    random.seed(1)
    other = NavigationEnv(generate_worlds(3, seed=9), protocol=PROTOCOLS.get("challenge"))
    other.reset(seed=4)
    found = {}
    for k in reversed(range(EPISODES)):
        if k % 7 == 0:  # left in the middle of a decision, and in contact
            other.step(np.full(8, -1.0, np.float32))
            other.loop.simulator.step((2.0, 0.3), 0.777)
            other.reset()
            env.reset(seed=k + 1000)
            env.loop.advance(300 + k)
        found[k] = episode(env, k)
    return [found[k] for k in range(EPISODES)]


@pytest.mark.slow
@pytest.mark.parametrize("arithmetic", ["exact", "fast"])
def test_fifty_episodes_are_the_same_in_two_processes_with_different_pasts(arithmetic: Arithmetic) -> None:
    root = Path(__file__).resolve().parents[2]
    processes = [
        subprocess.Popen(
            [sys.executable, "-m", "tests.integration.test_determinism", history, arithmetic],
            cwd=root,
            env={**os.environ, "PYTHONHASHSEED": seed, "OPENBLAS_NUM_THREADS": seed},
            stdout=subprocess.PIPE,
        )
        for history, seed in (("plain", "1"), ("used", "2"))
    ]
    plain, used = (json.loads(process.communicate(timeout=600)[0]) for process in processes)
    differing = [k for k in range(EPISODES) if plain[k] != used[k]]
    assert not differing
    assert len(plain) == EPISODES
    assert len({digest for digest, _ in plain}) == EPISODES, "episodes with different seeds must differ"
    assert sum(collided for _, collided in plain) >= EPISODES // 2, "contacts are part of what must repeat"


if __name__ == "__main__":
    sys.stdout.write(json.dumps(run(*sys.argv[1:3])))
