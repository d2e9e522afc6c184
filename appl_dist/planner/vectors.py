"""Checks of the planner's parts against vectors recorded from the real ROS code, one function a kind of file.

Every check yields `Tally`s: how many of a thing are equal, to the bit, and the largest difference seen. `arithmetic` is
that of PlannerSettings.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from appl_dist._native import Planner
from appl_dist.planner.dwa import DWA
from appl_dist.planner.planner_settings import Arithmetic, PlannerSettings
from appl_dist.spec import LaserGeometry

Array = NDArray[np.float64]
Record = dict[str, Any]


@dataclass
class Tally:
    """Equal things of one kind; `difference` in `unit`, infinite where shapes differ."""

    what: str
    unit: str
    total: int = 0
    equal: int = 0
    difference: float = 0.0

    def add(self, got: Any, want: Any, items: int = 1, whole: bool = True) -> bool:
        """Compare two arrays: as one thing (`whole`) or as `items` rows."""
        got, want = np.asarray(got, np.float64), np.asarray(want, np.float64)
        self.total += items
        if got.shape != want.shape:
            self.difference = math.inf
            return False
        wrong = got != want
        if got.size:
            self.difference = max(self.difference, float(np.abs(got - want).max()))
        if whole or not got.size:
            self.equal += 0 if wrong.any() else items
        else:
            self.equal += int((~wrong.reshape(items, -1).any(axis=1)).sum())
        return not wrong.any()

    def flag(self, ok: bool) -> None:
        """Count one thing that is right or wrong, without a size of the difference."""
        self.total += 1
        self.equal += ok


def parameter_values(params: Record, inflation_radius: float) -> Array:
    """(8,) values in the order of dwa.DWA; `params` has the live bias names, as dynamic_reconfigure does."""
    if params["min_vel_theta"] != -params["max_vel_theta"]:
        raise ValueError("min_vel_theta: expected -max_vel_theta")
    names = {"pdist_scale": "path_distance_bias", "gdist_scale": "goal_distance_bias"}
    listed = [params[names.get(n, n)] for n in DWA.names if n != "inflation_radius"]
    return np.array([*listed, inflation_radius], np.float64)


def settings_of(scene: Record, meter_scoring: bool, arithmetic: Arithmetic = "exact") -> PlannerSettings:
    """Settings of a scene or an episode: its own where it names them, else the Jackal's."""
    params = scene["params"]
    known = {n: params[n] for n in PlannerSettings.__dataclass_fields__ if n in params}
    corners = np.abs(np.array(scene["footprint"]))
    known |= {
        "meter_scoring": meter_scoring,
        "arithmetic": arithmetic,
        "half_length_m": float(corners[:, 0].max()),
        "half_width_m": float(corners[:, 1].max()),
        "footprint_padding": scene["footprint_padding"],
        "resolution_m": scene["res"],
        "controller_frequency": scene.get("controller_frequency", 20.0),
        "cost_scaling_factor": scene.get("cost_scaling_factor", 10.0),
    }
    if "W" in scene:
        known["local_size_m"] = scene["W"] * scene["res"]
    return PlannerSettings(**known)


def laser_of(scene: Record) -> LaserGeometry:
    """The lidar of a scene or an episode: at its own place where it names one, else the Jackal's."""
    return LaserGeometry(mount_x_m=scene.get("laser_x", LaserGeometry.mount_x_m))


def _scene_planner(scene: Record, meter_scoring: bool) -> Any:
    """The C planner with the scene's map, plan and parameters."""
    values = parameter_values(scene["params"], scene["inflation_radius"])
    planner = Planner(settings_of(scene, meter_scoring), laser_of(scene), values)
    planner.reset(np.zeros(3))
    lethal = np.zeros((scene["H"], scene["W"]), np.uint8)
    lethal.flat[scene["lethal"]] = 254
    planner.load_map(True, lethal, scene["ox"], scene["oy"])
    planner.inflate(True)
    planner.set_plan(np.array(scene["plan"], np.float64).reshape(-1, 2), scene["goal_yaw"])
    return planner


def _command_agrees(planner: Any, ok: bool, want: Record) -> bool:
    """Best sample, its cost, flags and pruned plan, where the vector has them."""
    status, best = planner.status(), planner.best_sample()
    if want.get("best") is None:
        agrees = bool(np.isnan(best).all())
    else:
        agrees = best[:2].tolist() == want["best"] and best[2] == want["best_cost"]
        agrees &= want.get("best_npts") in (None, len(planner.best()))
        if want.get("best_end") is not None:
            agrees &= planner.best()[-1].tolist() == want["best_end"]
    agrees &= ok == want["ok"] and all(status[k] == v for k, v in want["state"].items())
    agrees &= want.get("plan_local_len") in (None, status["local_count"])
    agrees &= want.get("plan_pruned_len") in (None, status["plan_left"])
    ends = planner.local_plan_ends()
    if want.get("plan_local_first") is not None:
        agrees &= ends == (*want["plan_local_first"], *want["plan_local_last"])
    return bool(agrees)


def trajectory_scenes(records: Iterator[Record]) -> Iterator[Tally]:
    """tp.jsonl: TrajectoryPlannerROS, one call from a fresh planner, with and without meter scoring."""
    commands = Tally("commands", "m/s or rad/s")
    in_cells = Tally("commands without meter scoring", "m/s or rad/s")
    states = Tally("best samples, costs and states", "")
    samples = Tally("samples", "cost")
    for record in records:
        scene = record["scene"]
        for tally, meter, want in ((commands, True, record["out"]), (in_cells, False, record["out_cells"])):
            pose, twist = np.array(scene["pose"], np.float64), np.array(scene["vel"], np.float64)
            fast = _scene_planner(scene, meter)
            ok, command, _ = fast.local_command(pose, twist, False)
            tally.add(command, want["cmd"])
            states.flag(_command_agrees(fast, ok, want))
            if want.get("samples"):
                traced = _scene_planner(scene, meter)
                _, _, rows = traced.local_command(pose, twist, True)
                samples.add(rows, want["samples"], items=len(want["samples"]), whole=False)
    yield from (commands, in_cells, states, samples)


def wavefront_grids(data: Any, scenes: dict[int, Record]) -> Iterator[Tally]:
    """tp_grids.npz: path and goal distances of the scenes it names."""
    cells = Tally("grid cells", "cells")
    for i, scene_id in enumerate(data["id"]):
        scene = scenes[int(scene_id)]["scene"]
        planner = _scene_planner(scene, True)
        planner.local_command(np.array(scene["pose"], np.float64), np.array(scene["vel"], np.float64), True)
        want = np.stack([data["path_grid"][i], data["goal_grid"][i]])
        cells.add(planner.wavefronts(), want, items=want.size, whole=False)
    yield cells


def inflated_maps(data: Any) -> Iterator[Tally]:
    """inflation.npz: InflationLayer over whole local maps."""
    maps, cells = Tally("maps", "cost"), Tally("cells", "cost")
    costs, packed = data["costmap"], data["lethal"]
    for i, want in enumerate(costs):
        size = len(want)
        values = DWA.defaults
        values[DWA.names.index("inflation_radius")] = data["inflation_radius"][i]
        resolution = float(data["resolution"])
        settings = PlannerSettings(
            cost_scaling_factor=float(data["cost_scaling_factor"][i]),
            resolution_m=resolution,
            local_size_m=size * resolution,
            # What makes the inscribed radius of the padded footprint the vector's.
            half_width_m=float(data["inscribed_radius"][i]) - 0.1,
        )
        planner = Planner(settings, LaserGeometry(), values)
        lethal = np.unpackbits(packed[i], axis=1)[:, :size].astype(np.uint8) * 254
        planner.load_map(True, lethal, *data["origin"][i])
        planner.inflate(True)
        got = planner.map(True, False)
        maps.add(got, want)
        cells.add(got, want, items=want.size, whole=False)
    yield from (maps, cells)


def global_plans(data: Any, arithmetic: Arithmetic = "exact") -> Iterator[Tally]:
    """navfn.npz: NavfnROS::makePlan, and potentials and costs where stored."""
    plans, found = Tally("plans", "m"), Tally("plans found or refused", "")
    potentials, costs = Tally("potential cells", ""), Tally("cost cells", "cost")
    lethal_at = np.concatenate([[0], np.cumsum(data["lethal_len"])])
    plan_at = np.concatenate([[0], np.cumsum(data["plan_len"])])
    arrays = {k: data[k] for k in ("lethal_flat", "plan_xy", "start", "goal", "ok", "inflation_radius")}
    stored = {int(scene): k for k, scene in enumerate(data["sel"])} if "sel" in data else {}
    arrays |= {k: data[k] for k in ("potential", "costmap") if stored}
    resolution, shape, origin = float(data["resolution"]), data["shape"], data["origin"]
    if shape[0] != shape[1]:
        raise ValueError(f"shape: got {shape[0]} x {shape[1]} cells; expected a square map")
    size_m = int(shape[0]) * resolution
    settings = PlannerSettings(resolution_m=resolution, global_size_m=size_m, arithmetic=arithmetic)
    for i in range(len(arrays["ok"])):
        values = DWA.defaults
        values[DWA.names.index("inflation_radius")] = arrays["inflation_radius"][i]
        planner = Planner(settings, LaserGeometry(), values)
        lethal = np.zeros(tuple(shape), np.uint8)
        lethal.flat[arrays["lethal_flat"][lethal_at[i] : lethal_at[i + 1]]] = 254
        planner.load_map(False, lethal, *origin)
        planner.inflate(False)
        start, goal = arrays["start"][i].copy(), arrays["goal"][i].copy()
        plan = planner.plan_between(start, goal, False)
        found.flag(bool(len(plan)) == bool(arrays["ok"][i]))
        plans.add(plan, arrays["plan_xy"][plan_at[i] : plan_at[i + 1]])
        if i in stored:
            k = stored[i]
            planner.plan_between(start, goal, True)
            potentials.add(planner.potential(), arrays["potential"][k], items=lethal.size, whole=False)
            costs.add(planner.map(False, False), arrays["costmap"][k], items=lethal.size, whole=False)
    yield from (plans, found)
    if stored:
        yield from (potentials, costs)
