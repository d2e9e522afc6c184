"""How fast one actor collects: transitions/s, multiple of real time, where the time goes, memory, start-up.

    python benchmarks/actor_throughput.py --worlds ../shared/barn --seconds 20 --processes 1 2

Everything of a real actor except the wire: exploration noise, a policy forward of the papers' network, every
planner stage. Two plain busy loops tell what two cores of this machine are worth.
"""

from __future__ import annotations

import argparse
import itertools
import multiprocessing
import os
import subprocess
import sys
import time
from collections.abc import Callable
from typing import Any

import numpy as np
import psutil

PAPER_TRANSITIONS_PER_CPU_S = 0.46  # 231 transitions/s on 500 CPUs


def papers_policy(rng: np.random.Generator) -> Any:
    """A random policy of the papers' shape: 729-512-512-512-8."""
    from paper_sizes import LAYOUT, OBSERVATION_SIZE

    from appl_dist.planner.dwa import DWA
    from appl_dist.policy.network import MLPPolicy
    from appl_dist.policy_file import PolicyFile

    sizes = [OBSERVATION_SIZE, 512, 512, 512, 8]
    weights = tuple(rng.normal(0, 1 / np.sqrt(i), (o, i)).astype(np.float32) for i, o in itertools.pairwise(sizes))
    return MLPPolicy(
        PolicyFile(weights, tuple(np.zeros(o, np.float32) for o in sizes[1:]), space=DWA, observation=LAYOUT)
    )


def run_actor(overrides: list[str], seconds: float, seed: int, out: Any) -> None:
    from appl_dist.actor.env import NavigationEnv
    from appl_dist.actor.exploration import ExplorationSettings, explore
    from appl_dist.actor.rollout import collect
    from appl_dist.actor.world_split import select_worlds
    from appl_dist.config import load

    settings = load(overrides)
    env = NavigationEnv(
        select_worlds(settings.world.path, 300, 0, "train"),
        timing=settings.timing,
        planner=settings.planner,
        robot=settings.robot,
    )
    rng = np.random.default_rng(seed)
    policy = papers_policy(rng)
    explorer = ExplorationSettings()
    policy_s, policy_calls = 0.0, 0

    def choose(observation: Any) -> Any:
        nonlocal policy_s, policy_calls
        began = time.perf_counter()
        action = explore(policy.act(observation), explorer, 50_000, 100_000, rng)
        policy_s += time.perf_counter() - began
        policy_calls += 1
        return action

    env.reset(seed=seed)
    transitions, simulated_s, episodes = 0, 0.0, 0
    start = time.perf_counter()
    while time.perf_counter() - start < seconds:
        rollout = collect(env, choose, world=env.next_world())
        assert rollout is not None
        transitions += len(rollout)
        simulated_s += env.loop.now_ms / 1000.0
        episodes += 1
    wall = time.perf_counter() - start
    memory = psutil.Process().memory_info().rss / 2**20
    stages = {name: tuple(spent) for name, spent in env.loop.stages.items()} | {"policy": (policy_s, policy_calls)}
    out.put((transitions, simulated_s, episodes, wall, memory, stages))
    env.close()


def busy(seconds: float, out: Any) -> None:
    end, n = time.perf_counter() + seconds, 0
    while time.perf_counter() < end:
        for _ in range(10_000):
            n += 1
    out.put(n)


def together(target: Callable[..., None], arguments: list[tuple[Any, ...]]) -> list[Any]:
    context = multiprocessing.get_context("spawn")
    queue = context.Queue()
    processes = [context.Process(target=target, args=(*a, queue)) for a in arguments]
    for p in processes:
        p.start()
    results = [queue.get() for _ in processes]
    for p in processes:
        p.join()
    return results


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--worlds", default="", help="folder of BARN worlds; generated ones without")
    parser.add_argument("--timing", default="gazebo")
    parser.add_argument("--seconds", type=float, default=20.0)
    parser.add_argument("--processes", type=int, nargs="+", default=[1, 2])
    parser.add_argument("--arithmetic", choices=["exact", "fast"], default="fast", help="fast: as actors train")
    a = parser.parse_args()
    overrides = [f"timing={a.timing}", f"world.path={a.worlds}", f"planner.arithmetic={a.arithmetic}"]
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # as in `appl-dist actor`: its idle threads would take a core

    start = time.perf_counter()
    subprocess.run([sys.executable, "-c", "import appl_dist.actor.collect, appl_dist.config"], check=True)
    print(f"start-up (interpreter and imports of an actor): {time.perf_counter() - start:.2f} s")

    [(_, sim_s, episodes, wall, memory, stages)] = together(run_actor, [(overrides, a.seconds, 0)])
    print(
        f"\nwhere the time goes, {a.timing} timing, {a.arithmetic} arithmetic, {episodes} episodes, "
        f"{sim_s:.0f} simulated seconds"
    )
    print(f"{'stage':<16}{'ms per simulated s':>20}{'share':>8}{'calls per sim. s':>18}")
    for stage, (seconds, calls) in sorted(stages.items(), key=lambda kv: -kv[1][0]):
        print(f"{stage:<16}{1000 * seconds / sim_s:>20.3f}{seconds / wall:>8.1%}{calls / sim_s:>18.1f}")
    rest = wall - sum(seconds for seconds, _ in stages.values())
    print(f"{'Python and rest':<16}{1000 * rest / sim_s:>20.3f}{rest / wall:>8.1%}")

    single = 0.0
    columns = ("processes", "transitions/s", "x real time", "x paper CPU", "MiB each", "speed-up")
    print("\n" + "".join(f"{c:>15}" for c in columns))
    for k in a.processes:
        results = together(run_actor, [(overrides, a.seconds, i) for i in range(k)])
        rate = sum(n / w for n, _, _, w, *_ in results)
        real = sum(s / w for _, s, _, w, *_ in results)
        memory = max(m for *_, m, _ in results)
        single = single or rate / k
        per_cpu = rate / k / PAPER_TRANSITIONS_PER_CPU_S
        print(f"{k:>15}{rate:>15.1f}{real:>15.0f}{per_cpu:>15.0f}{memory:>15.0f}{rate / single:>15.2f}")
    for k in a.processes:
        loops = together(busy, [(3.0,)] * k)
        print(f"{k} plain busy loop(s): {sum(loops) / 3e6:.1f} M increments/s")


if __name__ == "__main__":
    main()
