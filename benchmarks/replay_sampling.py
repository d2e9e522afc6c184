"""Replay against stable-baselines3's and torchrl's: bytes per transition, inserts and batches per second; size on disk,
and what the compact scan costs a policy.

    python benchmarks/replay_sampling.py [--transitions 200000] [--folder FOLDER]

The peers get what their documentation recommends for long observations: stable-baselines3's memory-saving buffer,
torchrl's memory-mapped storage, the next observation stored too. torchrl is needed for its row only: pip install
torchrl.
"""

from __future__ import annotations

import argparse
import contextlib
import shutil
import statistics
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
from paper_sizes import LAYOUT, LIDAR_BEAMS, OBSERVATION_SIZE, SIZES

from appl_dist.learner.replay import Replay
from appl_dist.learner.settings import TD3Settings
from appl_dist.learner.td3 import TD3
from appl_dist.planner.dwa import DWA
from appl_dist.policy.network import MLPPolicy
from appl_dist.policy_file import PolicyFile
from appl_dist.spec import Rollout

EPISODE, BATCH, BATCHES = 40, 256, 300
PEER_TRANSITIONS = 20_000  # the peers' buffers grow by about 6 KB each


def episodes() -> list[Rollout]:
    """Fifty episodes of noise."""
    rng = np.random.default_rng(0)

    def uniform(*shape: int) -> np.ndarray:
        return rng.uniform(-1, 1, shape).astype(np.float32)

    return [
        Rollout(uniform(EPISODE + 1, OBSERVATION_SIZE), uniform(EPISODE, 8), uniform(EPISODE), True, {}, LIDAR_BEAMS)
        for _ in range(50)
    ]


def report(name: str, bytes_each: float, inserts_per_s: float, sample: Callable[[], object]) -> None:
    times = []
    for _ in range(BATCHES):
        began = time.perf_counter()
        sample()
        times.append(time.perf_counter() - began)
    ms = statistics.median(times) * 1e3
    print(f"{name:34s} {bytes_each:8.0f} {inserts_per_s:12,.0f} {ms:10.2f} {BATCH / ms * 1e3:12,.0f}", flush=True)


def ours(folder: Path | None, transitions: int, n_step: int = 3, priority_exponent: float = 0.0) -> Replay:
    rng = np.random.default_rng(0)
    data = episodes()
    replay = Replay(folder, transitions, n_step, 0.99, **SIZES, priority_exponent=priority_exponent)
    began = time.perf_counter()
    for seq in range(transitions // EPISODE):
        replay.ring.insert(data[seq % len(data)], "bench", seq)
    rate = replay.ring.transitions_total / (time.perf_counter() - began)
    rows = replay._rows.data.itemsize * (EPISODE + 1) / EPISODE

    def sample() -> None:
        batch = replay.sample(BATCH, rng)
        if batch.rows is not None:
            replay.prioritise(batch.rows, batch.returns)

    where = "memory" if folder is None else "mapped"
    kind = ", prioritised" if priority_exponent else ""
    report(f"appl_dist, {where}, {n_step}-step{kind}", rows, rate, sample)
    return replay


def stable_baselines() -> None:
    import gymnasium
    from stable_baselines3.common.buffers import NStepReplayBuffer, ReplayBuffer

    box = gymnasium.spaces.Box
    spaces = (box(-1, 1, (OBSERVATION_SIZE,)), box(-1, 1, (8,)))
    for name, make in (
        ("1-step", lambda: ReplayBuffer(PEER_TRANSITIONS, *spaces, "cpu", optimize_memory_usage=True,
                                        handle_timeout_termination=False)),
        ("3-step", lambda: NStepReplayBuffer(PEER_TRANSITIONS, *spaces, "cpu", n_steps=3)),
    ):  # fmt: skip
        buffer = make()
        began = time.perf_counter()
        for r in episodes() * (PEER_TRANSITIONS // 50 // EPISODE):
            for i in range(len(r)):
                done = np.array([i == len(r) - 1])
                buffer.add(r.observations[i], r.observations[i + 1], r.actions[i], r.rewards[i : i + 1], done, [{}])
        rate = PEER_TRANSITIONS / (time.perf_counter() - began)
        arrays = (a for a in vars(buffer).values() if isinstance(a, np.ndarray))
        size = sum(a.nbytes for a in arrays) / PEER_TRANSITIONS
        report(f"stable-baselines3, {name}", size, rate, lambda buffer=buffer: buffer.sample(BATCH))


def torch_rl(folder: Path) -> None:
    import torch
    from tensordict import TensorDict
    from torchrl.data import LazyMemmapStorage, TensorDictReplayBuffer

    storage = LazyMemmapStorage(PEER_TRANSITIONS, scratch_dir=str(folder))
    buffer = TensorDictReplayBuffer(storage=storage, batch_size=BATCH)
    began = time.perf_counter()
    for r in episodes() * (PEER_TRANSITIONS // 50 // EPISODE):
        done = torch.zeros(len(r), 1, dtype=torch.bool)
        done[-1] = True
        observations = torch.from_numpy(r.observations)
        following = {"observation": observations[1:], "reward": torch.from_numpy(r.rewards)[:, None], "done": done}
        row = {"observation": observations[:-1], "action": torch.from_numpy(r.actions), "next": following}
        buffer.extend(TensorDict(row, [len(r)]))
    rate = PEER_TRANSITIONS / (time.perf_counter() - began)
    used = sum(f.stat().st_blocks * 512 for f in folder.rglob("*") if f.is_file())
    report("torchrl, mapped, 1-step", used / PEER_TRANSITIONS, rate, buffer.sample)


def scan_cost() -> None:
    """How far a stored scan's rounding moves the actions of untrained networks of the paper's size."""
    rng = np.random.default_rng(0)
    for dtype, levels in (("uint8", 255), ("uint16", 65535)):
        worst = []
        for seed in range(5):
            learner = TD3(TD3Settings(precision="fp32"), OBSERVATION_SIZE, 8, seed=seed)
            for parameter in learner.actor.parameters():
                parameter.data.mul_(3.0)  # trained weights are larger than initial ones
            policy = MLPPolicy(PolicyFile(*learner.policy_arrays(), space=DWA, observation=LAYOUT))
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
    parser = argparse.ArgumentParser(description="Speed and size of replay, ours and others'.")
    parser.add_argument("--transitions", type=int, default=200_000)
    parser.add_argument("--folder", type=Path, default=None, help="where the disk is; default the system's")
    args = parser.parse_args()
    print(f"{'':34s} {'bytes':>8s} {'inserts/s':>12s} {f'{BATCH}, ms':>10s} {'samples/s':>12s}")
    ours(None, args.transitions)
    ours(None, args.transitions, n_step=1)
    ours(None, args.transitions, priority_exponent=0.6)
    folder = Path(tempfile.mkdtemp(dir=args.folder))
    try:
        replay = ours(folder / "ours", args.transitions)
        stable_baselines()
        with contextlib.suppress(ImportError):
            torch_rl(folder / "torchrl")
        used = sum(f.stat().st_blocks * 512 for f in (folder / "ours").iterdir())
        each = used / len(replay.ring)
        print(f"on disk: {used / 1e6:.0f} MB, {each:.0f} bytes a transition, 5 M: {each * 5e6 / 1e9:.2f} GB")
        replay.close()
        began = time.perf_counter()
        Replay(folder / "ours", args.transitions, 3, 0.99, **SIZES).close()
        print(f"reopened in {(time.perf_counter() - began) * 1e3:.1f} ms")
    finally:
        shutil.rmtree(folder)
    scan_cost()


if __name__ == "__main__":
    main()
