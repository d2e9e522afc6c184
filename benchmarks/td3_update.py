"""TD3 updates per second (729-…-8, batch 256) beside stable-baselines3 and, with --old, an earlier revision.

Each learner is a process of its own that samples from its own replay and takes full gradient steps. They run in turns
of a few updates, so that other work on the machine slows all alike. Reports medians of the clock and of the processor
time, and of the ratios within each round.

    python benchmarks/td3_update.py [--rounds 20] [--threads 1 2] [--old CHECKOUT]

CHECKOUT is another working tree with a .venv of its own (`make venv` there).
"""

from __future__ import annotations

import argparse
import statistics
import subprocess
import sys
import time
from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import numpy as np
import torch

UPDATES = 6  # a turn; a multiple of the policy delay
BATCH = 256
TRANSITIONS = 20_000
EPISODE = 40
OBSERVATION, ACTION = 729, 8
BASELINE = "stable-baselines3"


def episodes() -> list[tuple[Any, Any, Any]]:
    """Observations (41, 729), actions (40, 8) and rewards (40,) of each episode: noise."""
    rng = np.random.default_rng(0)

    def uniform(*shape: int) -> Any:
        return rng.uniform(-1, 1, shape).astype(np.float32)

    return [
        (uniform(EPISODE + 1, OBSERVATION), uniform(EPISODE, ACTION), uniform(EPISODE))
        for _ in range(TRANSITIONS // EPISODE)
    ]


def ours(hidden: tuple[int, ...], threads: int, precision: str) -> Callable[[], None]:
    from paper_sizes import SIZES

    from appl_dist.learner.replay import Replay
    from appl_dist.learner.settings import TD3Settings
    from appl_dist.learner.td3 import TD3
    from appl_dist.spec import Rollout

    replay = Replay(None, TRANSITIONS, n_step=1, gamma=0.99, **SIZES)
    for seq, (observations, actions, rewards) in enumerate(episodes()):
        replay.ring.insert(Rollout(observations, actions, rewards, True, {}), "bench", seq)
    settings = TD3Settings(hidden=hidden, batch_size=BATCH, precision=precision, threads=threads)
    learner = TD3(settings, OBSERVATION, ACTION)
    rng = np.random.default_rng(0)

    def turn() -> None:
        for _ in range(UPDATES):
            learner.update(replay.sample(BATCH, rng))

    return turn


def baseline(hidden: tuple[int, ...], threads: int) -> Callable[[], None]:
    import gymnasium
    from stable_baselines3 import TD3 as BaselineTD3
    from stable_baselines3.common.logger import Logger

    class Spaces(gymnasium.Env):  # type: ignore[type-arg]
        observation_space = gymnasium.spaces.Box(-1, 1, (OBSERVATION,))
        action_space = gymnasium.spaces.Box(-1, 1, (ACTION,))

    torch.set_num_threads(threads)
    model = BaselineTD3(
        "MlpPolicy", Spaces(), learning_rate=3e-4, buffer_size=TRANSITIONS, batch_size=BATCH, device="cpu",
        policy_kwargs={"net_arch": [*hidden]},
    )  # fmt: skip
    model.set_logger(Logger(None, []))
    buffer = model.replay_buffer
    assert buffer is not None
    for observations, actions, rewards in episodes():
        for i in range(EPISODE):
            last = np.array([i == EPISODE - 1])
            buffer.add(observations[i], observations[i + 1], actions[i], rewards[i : i + 1], last, [{}])
    return lambda: model.train(gradient_steps=UPDATES, batch_size=BATCH)


def serve(args: argparse.Namespace) -> None:
    """A learner's process: one turn for each line of standard input, answered with its clock and processor seconds."""
    hidden = tuple(args.hidden)
    if args.learner == BASELINE:
        turn = baseline(hidden, args.threads[0])
    else:
        turn = ours(hidden, args.threads[0], args.precision)
    for _ in sys.stdin:
        began, used = time.perf_counter(), time.process_time()
        turn()
        print(time.perf_counter() - began, time.process_time() - used, flush=True)


Times = tuple[float, float]  # clock and processor seconds of a turn


def start(stack: ExitStack, python: str, learner: str, args: argparse.Namespace, hidden: Any, threads: int) -> Any:
    """The learner's process as a function that runs one turn."""
    command = [python, __file__, "--learner", learner, "--precision", args.precision]
    command += ["--threads", str(threads), "--hidden", *map(str, hidden)]
    process = stack.enter_context(
        subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, stderr=subprocess.DEVNULL)
    )
    assert process.stdin is not None and process.stdout is not None
    stdin, stdout = process.stdin, process.stdout
    stack.callback(stdin.close)

    def turn() -> Times:
        print(file=stdin, flush=True)
        clock, used = map(float, stdout.readline().split())
        return clock, used

    turn()
    return turn


def compare(args: argparse.Namespace, hidden: tuple[int, ...], threads: int) -> None:
    """Print a row of the table for each learner."""
    with ExitStack() as stack:
        pythons = {BASELINE: sys.executable, "appl_dist": sys.executable}
        if args.old:
            pythons["appl_dist before"] = str(args.old / ".venv/bin/python")
        turns = {name: start(stack, python, name, args, hidden, threads) for name, python in pythons.items()}
        times: dict[str, list[Times]] = {name: [] for name in turns}
        for _ in range(args.rounds):
            for name, turn in turns.items():
                times[name].append(turn())
    for name, own in times.items():
        clock, used = (statistics.median(t[i] for t in own) / UPDATES for i in (0, 1))
        row = f"| {'×'.join(map(str, hidden))} | {threads} | {name} | {1 / clock:.1f} | {1e3 * used:.1f} "
        for peer in (BASELINE, "appl_dist before"):
            if peer in times:
                ratios = [statistics.median(a[i] / b[i] for a, b in zip(times[peer], own, strict=True)) for i in (0, 1)]
                row += f"| {ratios[0]:.2f} ({ratios[1]:.2f}) "
        print(f"{row}|", flush=True)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else "")
    parser.add_argument("--rounds", type=int, default=20)
    parser.add_argument("--threads", type=int, nargs="+", default=[1, 2])
    parser.add_argument("--old", type=Path, help="a checkout of an earlier revision")
    parser.add_argument("--precision", choices=["auto", "bf16", "fp32"], default="auto")
    parser.add_argument("--hidden", type=int, nargs="+", help="one network instead of 512 512 512 and 256 256")
    parser.add_argument("--learner", help=argparse.SUPPRESS)
    args = parser.parse_args()
    if args.learner:
        return serve(args)
    before = " against before (processor) |" if args.old else ""
    print(f"| hidden | threads | learner | updates/s | processor ms | against {BASELINE} (processor) |{before}")
    print("|---" * (7 if args.old else 6) + "|")
    for hidden in [tuple(args.hidden)] if args.hidden else [(512, 512, 512), (256, 256)]:
        for threads in args.threads:
            compare(args, hidden, threads)
    return None


if __name__ == "__main__":
    main()
