"""Replay: inserts and batches per second, size on disk, and what the compact scan costs a policy.

python benchmarks/replay.py [--transitions 1000000] [--folder FOLDER]
"""

from __future__ import annotations

import argparse
import shutil
import statistics
import tempfile
import time
from pathlib import Path

import numpy as np

from appl_dist.actor.policy import MLPPolicy
from appl_dist.learner.replay import Replay
from appl_dist.learner.settings import TD3Settings
from appl_dist.learner.td3 import TD3
from appl_dist.policy_file import PolicyFile
from appl_dist.spec import LIDAR_BEAMS, OBSERVATION_SIZE, Rollout

EPISODE, BATCH = 40, 256


def measure(folder: Path | None, transitions: int) -> Replay:
    rng = np.random.default_rng(0)

    def uniform(*shape: int) -> np.ndarray:
        return rng.uniform(-1, 1, shape).astype(np.float32)

    data = [
        Rollout(uniform(EPISODE + 1, OBSERVATION_SIZE), uniform(EPISODE, 8), uniform(EPISODE), True, {})
        for _ in range(50)
    ]
    replay = Replay(folder, transitions, n_step=3, gamma=0.99)
    began = time.perf_counter()
    for seq in range(transitions // EPISODE):
        replay.insert(data[seq % len(data)], "bench", seq)
    rate = replay.transitions_total / (time.perf_counter() - began)
    times = []
    for _ in range(300):
        began = time.perf_counter()
        replay.sample(BATCH, rng)
        times.append(time.perf_counter() - began)
    where = "memory" if folder is None else "folder"
    print(f"{where}: {rate:,.0f} transitions/s in; batch of {BATCH}: {statistics.median(times) * 1e3:.2f} ms")
    return replay


def scan_cost() -> None:
    """How far a stored scan's rounding moves the actions of untrained networks of the paper's size."""
    rng = np.random.default_rng(0)
    for dtype, levels in (("uint8", 255), ("uint16", 65535)):
        worst = []
        for seed in range(5):
            learner = TD3(TD3Settings(precision="fp32"), OBSERVATION_SIZE, 8, seed=seed)
            learner.actor.flat.mul_(3.0)  # trained weights are larger than initial ones
            policy = MLPPolicy(PolicyFile(*learner.policy_arrays()))
            for _ in range(50):
                obs = rng.uniform(-1, 1, OBSERVATION_SIZE).astype(np.float32)
                stored = obs.copy()
                stored[:LIDAR_BEAMS] = np.rint((obs[:LIDAR_BEAMS] + 1) * levels / 2) * 2 / levels - 1
                worst.append(float(np.abs(policy.act(obs) - policy.act(stored)).max()))
        print(
            f"{dtype}: scan error at most {1e3 / levels:.3f} mm of range; "
            f"actions move by {np.mean(worst):.5f} on average, {max(worst):.5f} at most"
        )


def main() -> None:
    parser = argparse.ArgumentParser(description="Speed and size of replay.")
    parser.add_argument("--transitions", type=int, default=1_000_000)
    parser.add_argument("--folder", type=Path, default=None, help="where the disk is; default the system's")
    args = parser.parse_args()
    measure(None, args.transitions)
    folder = Path(tempfile.mkdtemp(dir=args.folder))
    try:
        replay = measure(folder, args.transitions)
        used = sum(f.stat().st_blocks * 512 for f in folder.iterdir())
        each = used / len(replay)
        print(f"on disk: {used / 1e6:.0f} MB, {each:.0f} bytes a transition, 5 M: {each * 5e6 / 1e9:.2f} GB")
        replay.close()
        began = time.perf_counter()
        Replay(folder, args.transitions, 3, 0.99).close()
        print(f"reopened in {(time.perf_counter() - began) * 1e3:.1f} ms")
    finally:
        shutil.rmtree(folder)
    scan_cost()


if __name__ == "__main__":
    main()
