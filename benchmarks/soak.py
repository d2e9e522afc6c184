"""Many simulated hours of random episodes in one process: does anything grow, drift, break or pass through a wall?

    python benchmarks/soak.py --hours 24 [--worlds ../shared/barn] [--processes 1] [--timing gazebo]

Each episode has new parameters every decision, in a random world. After it the robot is put somewhere on the course
and driven blindly for a few seconds, half the time at full speed, so that contacts of every kind are part of it.
Checked all along: observations, rewards, poses and scans are finite, the hull of a robot on its wheels is never more
than 3 cm inside an obstacle, no speed is above what the robot can do, nothing rolls over that touched nothing. (At
2 m/s, pushed on blindly, about one crash in a hundred climbs the cylinder until it does.) The first episode is
repeated at the end and must be the same, bit for bit. Ends with status 1 if anything did not hold.
"""

from __future__ import annotations

import argparse
import hashlib
import itertools
import math
import multiprocessing
import os
import sys
import time
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import psutil

DEEPEST_M = -0.03
ON_WHEELS_RAD = 0.5
FASTEST_MPS = 2.5  # 2 m/s of the wheels, and what a blow off a cylinder adds
BLIND_COMMANDS = 4  # of a second each
MIB = 2**20
MOST_FAULTS = 20  # listed


@dataclass
class Tally:
    """What one process saw."""

    episodes: int = 0
    decisions: int = 0
    simulated_s: float = 0.0
    cpu_s: float = 0.0
    successes: int = 0
    hits: int = 0
    contact_s: float = 0.0
    rolled_over: int = 0
    rolled_over_untouched: int = 0
    deepest_m: float = math.inf
    fastest_mps: float = 0.0
    resident_mib: list[float] = field(default_factory=list)  # at each simulated hour
    cpu_ms_per_s: list[float] = field(default_factory=list)  # of each simulated hour
    faults: list[str] = field(default_factory=list)
    repeats: bool = False


def episode(env: Any, number: int, seed: int, tally: Tally) -> str:
    """One random episode and its blind epilogue; returns the digest of both."""
    rng = np.random.default_rng([seed, number])
    digest = hashlib.sha256()
    simulator = env.loop.simulator

    def check(what: str, *values: Any) -> None:
        if len(tally.faults) < MOST_FAULTS and not all(np.isfinite(v).all() for v in values):
            tally.faults.append(f"episode {number}: {what} not finite")
        for value in values:
            digest.update(np.asarray(value).tobytes())

    def close() -> None:
        tally.hits += simulator.collided
        tally.rolled_over += simulator.rolled_over
        tally.rolled_over_untouched += simulator.rolled_over and not simulator.collided
        tally.simulated_s += simulator.time_s

    worlds = list(env.worlds)
    observation, _ = env.reset(seed=int(rng.integers(2**31)), options={"world": worlds[rng.integers(len(worlds))]})
    ended = False
    while not ended:
        check("observation", observation)
        action = rng.uniform(-1.0, 1.0, env.action_space.shape).astype(np.float32)
        observation, reward, terminated, truncated, info = env.step(action)
        check("reward or pose", reward, simulator.pose, simulator.odom_pose, simulator.odom_twist)
        ended = terminated or truncated
        tally.decisions += 1
    tally.successes += info["success"]
    deepest_m = math.inf if simulator.rolled_over else info["min_clearance_m"]
    close()
    start = env.world.path[rng.integers(len(env.world.path))]  # at least 0.375 m from anything
    simulator.reset(env.world, number, np.array([*start, rng.uniform(-math.pi, math.pi)]))
    for _ in range(BLIND_COMMANDS):
        v, w = float(np.clip(rng.uniform(-4.0, 4.0), -2.0, 2.0)), rng.uniform(-1.5, 1.5)
        for _ in range(50):
            simulator.step((v, w), 0.02)
            tally.contact_s += 0.02 * simulator.in_collision
            if simulator.tilt_rad < ON_WHEELS_RAD:  # the clearance is that of a level robot's outline
                deepest_m = min(deepest_m, simulator.clearance_m)
            tally.fastest_mps = max(tally.fastest_mps, math.hypot(simulator.twist[0], simulator.side_speed_mps))
        check("pose", simulator.pose, simulator.odom_pose, simulator.scan()[np.isfinite(simulator.scan())])
    close()
    tally.deepest_m = min(tally.deepest_m, deepest_m)
    if deepest_m < DEEPEST_M and len(tally.faults) < MOST_FAULTS:
        tally.faults.append(f"episode {number}: {-deepest_m:.3f} m inside an obstacle")
    tally.episodes += 1
    return digest.hexdigest()


def soak(overrides: list[str], hours: float, seed: int, number: int, out: Any) -> None:
    from appl_dist.actor.env import NavigationEnv
    from appl_dist.config import load
    from appl_dist.sim.generate import generate_worlds
    from appl_dist.sim.worlds import load_worlds

    settings = load(overrides)
    worlds = load_worlds(settings.world.path) if settings.world.path else generate_worlds(300, seed)
    env = NavigationEnv(worlds, timing=settings.timing, planner=settings.planner, robot=settings.robot)
    tally, process, started = Tally(), psutil.Process(), time.process_time()
    first, before = episode(env, 0, seed, tally), time.process_time()
    hour, sofar_s = 0, tally.simulated_s
    for k in itertools.count(1):
        if tally.simulated_s >= 3600.0 * (hour + 1):
            hour = int(tally.simulated_s // 3600)
            now = time.process_time()
            tally.resident_mib.append(process.memory_info().rss / MIB)
            tally.cpu_ms_per_s.append(1000.0 * (now - before) / (tally.simulated_s - sofar_s))
            before, sofar_s = now, tally.simulated_s
            print(
                f"process {number}: {hour} h, {tally.episodes} episodes, {tally.resident_mib[-1]:.1f} MiB, "
                f"{tally.cpu_ms_per_s[-1]:.1f} ms per simulated s, {tally.hits} hits, {len(tally.faults)} faults",
                flush=True,
            )
        if tally.simulated_s >= 3600.0 * hours:
            break
        episode(env, k, seed, tally)
    tally.cpu_s = time.process_time() - started
    tally.repeats = episode(env, 0, seed, Tally()) == first
    if tally.fastest_mps > FASTEST_MPS:
        tally.faults.append(f"{tally.fastest_mps:.2f} m/s")
    if tally.rolled_over_untouched:
        tally.faults.append(f"{tally.rolled_over_untouched} roll-overs without a contact")
    if not tally.repeats:
        tally.faults.append("the first episode came out differently at the end")
    out.put(tally)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--hours", type=float, default=24.0, help="simulated, of each process")
    parser.add_argument("--worlds", default="", help="folder of BARN worlds; generated ones without")
    parser.add_argument("--timing", default="gazebo")
    parser.add_argument("--arithmetic", choices=["exact", "fast"], default="fast")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--processes", type=int, default=1)
    a = parser.parse_args()
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    context = multiprocessing.get_context("spawn")
    queue = context.Queue()
    overrides = [f"timing={a.timing}", f"world.path={a.worlds}", f"planner.arithmetic={a.arithmetic}"]
    arguments = [(overrides, a.hours, a.seed + k, k, queue) for k in range(a.processes)]
    processes = [context.Process(target=soak, args=one) for one in arguments]
    for p in processes:
        p.start()
    for p in processes:
        p.join()
    bad = sum(p.exitcode != 0 for p in processes)
    for _ in range(a.processes - bad):
        t: Tally = queue.get()
        memory, pace = t.resident_mib or [math.nan], t.cpu_ms_per_s or [math.nan]
        print(
            f"\n{t.simulated_s / 3600:.1f} simulated hours, {t.episodes} episodes, {t.decisions} decisions, "
            f"{t.cpu_s / 60:.1f} CPU minutes\n"
            f"resident: {memory[0]:.1f} MiB after the first hour, {memory[-1]:.1f} after the last, "
            f"{max(memory):.1f} at most\n"
            f"CPU per simulated second: {pace[0]:.1f} ms in the first hour, {pace[-1]:.1f} in the last\n"
            f"{t.successes / t.episodes:.0%} successes; {t.hits} contacts in episodes and blind drives, "
            f"{t.contact_s:.0f} s of it in the latter\n"
            f"deepest in an obstacle {-1000 * t.deepest_m:.1f} mm, fastest {t.fastest_mps:.2f} m/s, {t.rolled_over} "
            f"roll-overs ({t.rolled_over_untouched} without contact)\n"
            f"the first episode again at the end: {'the same' if t.repeats else 'DIFFERENT'}"
        )
        for fault in t.faults:
            print(f"FAULT {fault}")
        bad += bool(t.faults)
    return 1 if bad else 0


if __name__ == "__main__":
    sys.exit(main())
