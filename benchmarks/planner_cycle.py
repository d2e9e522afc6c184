"""Time of the planner's stages and of its full cycle, beside the real C++ on one core (docs: planner.md figures).

    python benchmarks/planner_cycle.py [--seconds 20] [--parameters random] [--arithmetic fast]

Drives the noise-free robot through generated BARN worlds and takes the processor time of every call from Python, so
the call itself (about a microsecond) is included. Run it with PYTHONPATH of another checkout to compare the two.
"per simulated second" = 20 local updates, plans and controls, 10 global updates.

`--peer` adds the PyPI package dynamic-window-approach on the same scenes (it builds with `pip install 'cython<3'`,
then `pip install --no-build-isolation dynamic-window-approach`): about as many samples of the same 2 s, the scan's
points within 2.5 m as obstacles, a point of the global plan as its goal. It has no maps and no global plan, so it is
set beside local map and control.
"""

from __future__ import annotations

import argparse
import time
from collections import defaultdict
from typing import Any

import numpy as np

from appl_dist.planner.dwa import DWA
from appl_dist.planner.ideal_drive import cast_scan, drive
from appl_dist.planner.navigator import Navigator
from appl_dist.planner.planner_settings import PlannerSettings
from appl_dist.sim.generate import generate_worlds
from appl_dist.spec import LaserGeometry

# ms of the ROS code on one core of a server (AMD EPYC, -O2): default parameters, random ones for the control.
REAL_MS = {"local map": 0.11, "global map": 0.14, "plan": 1.65, "control": 1.33}
REAL_RANDOM_CONTROL_MS = 2.65
START_WORLD = np.array([-2.0, 3.0, 0.0])


def peer_config() -> Any:
    """dynamic-window-approach with the default parameters' limits, sample counts (6 x 20) and 2 s roll-outs."""
    import dwa

    return dwa.Config(
        max_speed=0.5,
        min_speed=0.1,
        max_yawrate=1.57,
        max_accel=10.0,
        max_dyawrate=20.0,
        velocity_resolution=0.4 / 6,
        yawrate_resolution=3.14 / 20,
        dt=0.1,  # the step its roll-outs are integrated with
        predict_time=2.0,
        heading=0.15,
        clearance=1.0,
        velocity=1.0,
        base=[-0.22, -0.22, 0.22, 0.22],
    )


def peer_plan(config: Any, scan: np.ndarray, pose: np.ndarray, twist: np.ndarray, path: np.ndarray) -> None:
    """One command of the peer; everything in the robot's frame, where its clearance grows least with distance."""
    import dwa

    angles = np.linspace(-2.35619, 2.35619, len(scan))
    near = scan < 2.5
    points = np.stack([scan[near] * np.cos(angles[near]) + 0.055, scan[near] * np.sin(angles[near])], axis=1)
    c, s = np.cos(pose[2]), np.sin(pose[2])
    ahead = path[min(20, len(path) - 1)] - pose[:2] if len(path) else np.array([1.0, 0.0])
    goal = (float(c * ahead[0] + s * ahead[1]), float(c * ahead[1] - s * ahead[0]))
    dwa.planning((0.0, 0.0, 0.0), (float(twist[0]), float(twist[1])), goal, points.astype(np.float32), config)


def run(
    world_index: int,
    seconds: float,
    random: bool,
    settings: PlannerSettings,
    times: dict[str, list[float]],
    peer: Any = None,
) -> None:
    """One drive; appends the ms of every call to `times`."""
    rng = np.random.default_rng(world_index)
    world = generate_worlds(world_index + 1)[world_index]
    cylinders = world.cylinders - START_WORLD
    navigator = Navigator(settings)
    navigator.reset(np.array([0.0, 10.0, 0.0]))
    pose, twist = np.array([0.0, 0.0, 1.57]), np.zeros(2)
    for k in range(int(seconds * 20)):
        if random and k % 40 == 0:
            navigator.set_parameters(DWA.to_values(rng.uniform(-1, 1, 8)))
        scan = cast_scan(cylinders, pose, LaserGeometry())
        now = time.thread_time()

        def lap(stage: str) -> None:
            nonlocal now
            after = time.thread_time()
            times[stage].append((after - now) * 1e3)
            now = time.thread_time()

        navigator.add_scan(scan, pose)
        lap("scan")
        navigator.update_local_map(pose)
        lap("local map")
        if k % 2 == 0:
            navigator.update_global_map(pose)
            lap("global map")
        navigator.plan(pose, 0.05 * k)
        lap("plan")
        command = navigator.control(pose, twist, 0.05 * k)
        lap("control")
        if peer is not None:
            peer_plan(peer, scan, pose, twist, navigator.path)
            lap("peer")
        pose, twist = drive(pose, twist, command, 5)
        if np.hypot(pose[0], pose[1] - 10.0) < 1.0:
            return


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seconds", type=float, default=20.0, help="simulated, a world")
    parser.add_argument("--worlds", type=int, nargs="*", default=[0, 90, 170, 250])
    parser.add_argument("--parameters", choices=["default", "random"], default="default")
    parser.add_argument("--arithmetic", choices=["exact", "fast"], default="exact")
    parser.add_argument("--peer", action="store_true", help="dynamic-window-approach beside it")
    args = parser.parse_args()
    settings = PlannerSettings() if args.arithmetic == "exact" else PlannerSettings(arithmetic=args.arithmetic)
    times: dict[str, list[float]] = defaultdict(list)
    peer = peer_config() if args.peer else None
    for index in args.worlds:
        run(index, args.seconds, args.parameters == "random", settings, times, peer)
    real = dict(REAL_MS)
    if args.parameters == "random":
        real["control"] = REAL_RANDOM_CONTROL_MS
    print(
        f"{'stage':12}{'mean ms':>9}{'median':>9}{'p99':>9}{'real C++':>10}{'ratio':>7}   {args.parameters} parameters"
    )
    per_second = {}
    for stage in ("scan", "local map", "global map", "plan", "control"):
        ms = np.array(times[stage])
        per_second[stage] = ms.mean() * (10 if stage == "global map" else 20)
        beside = f"{real[stage]:10.2f}{real[stage] / ms.mean():7.1f}" if stage in real else ""
        print(f"{stage:12}{ms.mean():9.3f}{np.median(ms):9.3f}{np.percentile(ms, 99):9.3f}{beside}")
    ours = sum(per_second.values())
    theirs = sum(real[s] * (10 if s == "global map" else 20) for s in real)
    print(f"per simulated second: {ours:.1f} ms; real C++ {theirs:.1f} ms; ratio {theirs / ours:.1f}")
    if args.peer:
        mine = np.mean(times["scan"]) + np.mean(times["local map"]) + np.mean(times["control"])
        other = np.mean(times["peer"])
        print(
            f"dynamic-window-approach: {other:.3f} ms a command; scan, local map and control: {mine:.3f}; "
            f"ratio {other / mine:.1f}"
        )


if __name__ == "__main__":
    main()
