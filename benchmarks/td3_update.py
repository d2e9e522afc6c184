"""TD3 updates per second on the paper's networks (729-512-512-512-8, batch 256) against stable-baselines3.

Both sample from their own replay and take full gradient steps on the same number of threads, in turns of a
few updates each so that a busy machine slows both alike. Reports the median of each and of their ratios, by the
clock and by the processor time spent, which other work on the machine disturbs less.

    python benchmarks/td3_update.py [--rounds 20] [--threads 1 2]
"""

from __future__ import annotations

import argparse
import statistics
import time
from collections.abc import Callable

import gymnasium
import numpy as np
import torch
from stable_baselines3 import TD3 as BaselineTD3
from stable_baselines3.common.logger import Logger

from appl_dist.learner.replay import Replay
from appl_dist.learner.settings import TD3Settings
from appl_dist.learner.td3 import TD3
from appl_dist.spec import OBSERVATION_SIZE, Rollout

UPDATES = 6  # a turn; a multiple of the policy delay
TRANSITIONS = 20_000
EPISODE = 40


class Shapes(gymnasium.Env):  # type: ignore[type-arg]
    """No environment, only the spaces."""

    observation_space = gymnasium.spaces.Box(-1, 1, (OBSERVATION_SIZE,))
    action_space = gymnasium.spaces.Box(-1, 1, (8,))


def rollouts(rng: np.random.Generator) -> list[Rollout]:
    def uniform(*shape: int) -> np.ndarray:
        return rng.uniform(-1, 1, shape).astype(np.float32)

    return [
        Rollout(uniform(EPISODE + 1, OBSERVATION_SIZE), uniform(EPISODE, 8), uniform(EPISODE), True, {})
        for _ in range(TRANSITIONS // EPISODE)
    ]


def ours(data: list[Rollout], precision: str, threads: int) -> Callable[[], None]:
    replay = Replay(None, TRANSITIONS, n_step=1, gamma=0.99)
    for seq, rollout in enumerate(data):
        replay.insert(rollout, "bench", seq)
    learner = TD3(TD3Settings(precision=precision, threads=threads), OBSERVATION_SIZE, 8)
    rng = np.random.default_rng(0)

    def turn() -> None:
        for _ in range(UPDATES):
            learner.update(replay.sample(256, rng))

    return turn


def baseline(data: list[Rollout]) -> Callable[[], None]:
    model = BaselineTD3(
        "MlpPolicy", Shapes(), learning_rate=3e-4, buffer_size=TRANSITIONS, batch_size=256, device="cpu",
        policy_kwargs={"net_arch": [512, 512, 512]},
    )  # fmt: skip
    model.set_logger(Logger(None, []))
    buffer = model.replay_buffer
    assert buffer is not None
    for r in data:
        for i in range(len(r)):
            last = np.array([i == len(r) - 1])
            buffer.add(r.observations[i], r.observations[i + 1], r.actions[i], r.rewards[i : i + 1], last, [{}])
    return lambda: model.train(gradient_steps=UPDATES, batch_size=256)


def compare(data: list[Rollout], threads: int, rounds: int) -> None:
    """Print what each does per second on so many threads."""
    torch.set_num_threads(threads)
    turns = {
        "stable-baselines3": baseline(data),
        "appl_dist fp32": ours(data, "fp32", threads),
        "appl_dist bf16": ours(data, "bf16", threads),
    }
    for turn in turns.values():
        turn()
    clock: dict[str, list[float]] = {name: [] for name in turns}
    processor: dict[str, list[float]] = {name: [] for name in turns}
    for _ in range(rounds):
        for name, turn in turns.items():
            began, used = time.perf_counter(), time.process_time()
            turn()
            clock[name].append((time.perf_counter() - began) / UPDATES)
            processor[name].append((time.process_time() - used) / UPDATES)
    print(f"{threads} thread(s)            updates/s   (best)   against stable-baselines3   processor ms   against")
    for name in turns:
        by_clock, by_processor = (
            statistics.median(a / b for a, b in zip(times["stable-baselines3"], times[name], strict=True))
            for times in (clock, processor)
        )
        rate, best = 1 / statistics.median(clock[name]), 1 / min(clock[name])
        used = 1e3 * statistics.median(processor[name])
        print(f"{name:20s} {rate:11.1f} {best:10.1f} {by_clock:20.2f} {used:20.1f} {by_processor:10.2f}", flush=True)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else "")
    parser.add_argument("--rounds", type=int, default=20)
    parser.add_argument("--threads", type=int, nargs="+", default=[1, 2])
    args = parser.parse_args()
    data = rollouts(np.random.default_rng(0))
    for threads in args.threads:
        compare(data, threads, args.rounds)


if __name__ == "__main__":
    main()
