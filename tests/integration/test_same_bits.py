"""A policy's actions, and the trial they drive, have the same bits whatever kernels BLAS and numpy choose."""

from __future__ import annotations

import hashlib
import json
import os
import subprocess
import sys
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from appl_dist.actor.env import NavigationEnv
from appl_dist.planner.dwa import DWA
from appl_dist.policy.network import MLPPolicy
from appl_dist.policy_file import PolicyFile
from appl_dist.sim.generate import generate_worlds
from tests.paper_sizes import LAYOUT, OBSERVATION_SIZE

ROOT = Path(__file__).resolve().parents[2]
FEATURES = np.show_config(mode="dicts")["SIMD Extensions"].get(
    "found", []
)  # beyond numpy's baseline, of this processor
CORES = {"PRESCOTT": "sse3", "NEHALEM": "sse4_2", "HASWELL": "avx2", "SKYLAKEX": "avx512f"}


def fractions(rng: np.random.Generator, *shape: int) -> np.ndarray:
    """float32 multiples of 2^-20 in [-1, 1): exact, so that the inputs are the same everywhere."""
    return rng.integers(-(2**20), 2**20, shape).astype(np.float32) / np.float32(2**20)


def write_policy(path: Path) -> None:
    rng = np.random.default_rng(0)
    pairs = list(pairwise((OBSERVATION_SIZE, 256, 256, 8)))
    weights = tuple(fractions(rng, outputs, inputs) / np.float32(16) for inputs, outputs in pairs)
    PolicyFile(weights, tuple(fractions(rng, outputs) for _, outputs in pairs), space=DWA, observation=LAYOUT).save(
        path
    )


def digests(path: Path) -> dict[str, str]:
    """Of 50 actions, of a trial driven by the policy, and of the same actions as numpy's products give them."""
    file = PolicyFile.load(path)
    policy = MLPPolicy(file)
    actions, products = hashlib.sha256(), hashlib.sha256()
    for observation in fractions(np.random.default_rng(1), 50, OBSERVATION_SIZE):
        actions.update(policy.act(observation).tobytes())
        x = observation
        for w, b in zip(file.weights, file.biases, strict=True):
            x = np.maximum(w @ x + b, 0)
        products.update(x.tobytes())
    env = NavigationEnv(generate_worlds(1, seed=5))
    observation, _ = env.reset(seed=0)
    for _ in range(5):
        observation, _, terminated, truncated, _ = env.step(policy.act(observation))
        if terminated or truncated:
            break
    return {"actions": actions.hexdigest(), "trial": env.loop.digest(), "numpy": products.hexdigest()}


def run(path: Path, **variables: str) -> dict[str, str]:
    """`digests` in a process of its own with environment `variables`."""
    command = [sys.executable, "-m", "tests.integration.test_same_bits", str(path)]
    environment = {**os.environ, **variables}
    done = subprocess.run(command, cwd=ROOT, env=environment, capture_output=True, text=True, check=True, timeout=300)
    found: dict[str, str] = json.loads(done.stdout)
    return found


@pytest.mark.slow
def test_actions_and_trials_have_the_same_bits_for_every_kernel_of_blas_and_numpy(tmp_path: Path) -> None:
    path = tmp_path / "policy.safetensors"
    write_policy(path)
    flags = Path("/proc/cpuinfo").read_text().split()
    found = {core: run(path, OPENBLAS_CORETYPE=core) for core, need in CORES.items() if need in flags}
    found |= {f"without {name}": run(path, NPY_DISABLE_CPU_FEATURES=name) for name in FEATURES}
    found |= {"as it is": run(path), "baseline": run(path, NPY_DISABLE_CPU_FEATURES=" ".join(FEATURES))}
    for what in ("actions", "trial"):
        assert len({digest[what] for digest in found.values()}) == 1, (what, found)
    if {"PRESCOTT", "HASWELL"} <= set(found):  # the variables do choose kernels
        assert found["PRESCOTT"]["numpy"] != found["HASWELL"]["numpy"]


if __name__ == "__main__":
    sys.stdout.write(json.dumps(digests(Path(sys.argv[1]))))
