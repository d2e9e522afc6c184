"""Checks of the whole planner against closed-loop episodes recorded with the real ROS code, tick by tick."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from appl_dist.planner import ideal_drive
from appl_dist.planner.navigator import Navigator, State
from appl_dist.planner.planner_settings import Arithmetic
from appl_dist.planner.vectors import Array, Record, Tally, laser_of, parameter_values, settings_of
from appl_dist.spec import LaserGeometry

FLAGS = (
    "stuck_left",
    "stuck_right",
    "rotating_left",
    "rotating_right",
    "escaping",
    "rotating_to_goal",
    "reached",
)
NO_COST = -99.0  # best_cost of a tick without a roll-out
CONTROL_PERIOD_S = 0.05
PHYSICS_STEPS = 5
SNAPSHOT_TICKS = 20  # maps and plans are stored this often


def episode_commands(records: Iterator[Record], arithmetic: Arithmetic) -> Iterator[Tally]:
    """sim.jsonl tick by tick: the command from the recorded poses and twists, whatever was commanded before."""
    commands = Tally("commands from recorded poses", "m/s or rad/s")
    for record in records:
        for k, (navigator, pose, twist, scan, want) in enumerate(_recorded_ticks(record, arithmetic)):
            _, command = _ideal_tick(navigator, k, scan, pose, twist, k * CONTROL_PERIOD_S)
            commands.add(command, want[6:8])
    yield commands


def _recorded_ticks(
    record: Record, arithmetic: Arithmetic
) -> Iterator[tuple[Navigator, Array, Array, Any, list[float]]]:
    episode = record["episode"]
    navigator, laser, cylinders = _start(episode, arithmetic)
    schedule = list(episode.get("schedule") or [])
    for k, want in enumerate(record["out"]["ticks"]):
        _apply_schedule(navigator, schedule, k * CONTROL_PERIOD_S)
        pose, twist = np.array(want[1:4], np.float64), np.array(want[4:6], np.float64)
        scan = ideal_drive.cast_scan(cylinders, pose, laser)
        yield navigator, pose, twist, scan, want


def episodes(records: Iterator[Record], full: Any | None) -> Iterator[Tally]:
    """sim.jsonl: closed loops with the ideal drive; `full`: the npz with scans and maps of some of them."""
    ticks, ends = Tally("ticks", "m, rad, m/s or rad/s"), Tally("episodes to their last tick", "")
    plans, scans, maps = Tally("plans", "m"), Tally("scans", "m"), Tally("local maps", "cost")
    for record in records:
        episode, out = record["episode"], record["out"]
        stored = {k: full[f"{k}_{episode['id']}"] for k in ("scan", "map") if full is not None
                  and f"{k}_{episode['id']}" in full}  # fmt: skip
        ends.flag(_replay(episode, out, stored, ticks, plans, scans, maps))
    yield from (ticks, ends, plans)
    if full is not None:
        yield from (scans, maps)


def _replay(
    episode: Record, out: Record, stored: Record, ticks: Tally, plans: Tally, scans: Tally, maps: Tally
) -> bool:
    """One episode, in our own closed loop; whether every tick and the way it ended are equal."""
    navigator, laser, cylinders = _start(episode, "exact")
    pose, twist = np.array(episode["start"], np.float64), np.zeros(2)
    schedule = list(episode.get("schedule") or [])
    before, end = ticks.equal, "timeout"
    for k, want in enumerate(out["ticks"]):
        now = k * CONTROL_PERIOD_S
        _apply_schedule(navigator, schedule, now)
        scan = ideal_drive.cast_scan(cylinders, pose, laser)
        planned, command = _ideal_tick(navigator, k, scan, pose, twist, now)
        gap = ideal_drive.clearance(cylinders, pose)
        row = [now, *pose, *twist, *command, *_tick_state(navigator, planned), *navigator.local_origin]
        ticks.add(row, [*want[:13], *want[14:]])
        if "scan" in stored:
            _add_scan(scans, scan, stored["scan"][k])
        if k % SNAPSHOT_TICKS == 0:
            plans.add(navigator.path, np.array(out["plans"][k // SNAPSHOT_TICKS]).reshape(-1, 2))
            if "map" in stored:
                maps.add(navigator.local_costmap, stored["map"][k // SNAPSHOT_TICKS])
        end = "collision" if gap < 0 else "reached" if navigator.goal_reached else end
        pose, twist = ideal_drive.drive(pose, twist, command, PHYSICS_STEPS)
    if navigator.state == State.CLEARING:
        end = "clearing"
    return ticks.equal - before == len(out["ticks"]) and out["end"].startswith(end)


def _start(episode: Record, arithmetic: Arithmetic) -> tuple[Navigator, LaserGeometry, Array]:
    """The navigator on its way to the episode's goal, its lidar, and the cylinders (n, 3)."""
    settings = settings_of(episode, episode["meter_scoring"], arithmetic)
    laser = laser_of(episode)
    navigator = Navigator(settings, laser, parameter_values(episode["params"], episode["inflation_radius"]))
    navigator.reset(np.array([*episode["goal"], episode["goal_yaw"]]))
    return navigator, laser, np.array(episode["cyl"], np.float64).reshape(-1, 3)


def _apply_schedule(navigator: Navigator, schedule: list[Record], now: float) -> None:
    while schedule and schedule[0]["t"] <= now + 1e-9:
        change = schedule.pop(0)
        navigator.set_parameters(parameter_values(change["params"], change["inflation_radius"]))


def _ideal_tick(
    navigator: Navigator, k: int, scan: NDArray[np.float32], pose: Array, twist: Array, now: float
) -> tuple[bool, Array]:
    """`Navigator.cycle`, call by call, to learn whether the plan succeeded."""
    navigator.add_scan(scan, pose)
    navigator.update_local_map(pose)
    if k % 2 == 0:
        navigator.update_global_map(pose)
    planned = navigator.plan(pose, now)
    return planned, navigator.control(pose, twist, now)


def _tick_state(navigator: Navigator, planned: bool) -> list[float]:
    """ok, best cost, flags, plan ok, plan length: as a tick's row lists them."""
    cost = navigator.best_cost
    flags = sum(1 << i for i, name in enumerate(FLAGS) if navigator.debug[name])
    return [
        float(navigator.command_valid),
        NO_COST if cost is None else cost,
        flags,
        float(planned),
        len(navigator.path) if planned else 0,
    ]


def _add_scan(scans: Tally, got: NDArray[np.float32], want: NDArray[np.float32]) -> None:
    """No return (inf) must be no return; differences count where both hit."""
    both = np.isfinite(got) & np.isfinite(want)
    scans.total += 1
    scans.equal += bool(np.array_equal(got, want))
    if both.any():
        scans.difference = max(scans.difference, float(np.abs(got[both] - want[both]).max()))
