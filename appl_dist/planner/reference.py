"""The roll-outs of `csrc/rollout.c` in plain Python: slow, meant to be read and to test the C against.

One call from a fresh planner: dynamic window, samples in order, wavefronts, scores, choice, escape.
Source: base_local_planner::TrajectoryPlanner (dwa: true). Only the memory over cycles (oscillation flags,
escaping) is left out.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from appl_dist.planner.planner_settings import PlannerSettings

LETHAL, INSCRIBED, UNKNOWN = 254, 253, 255
Cell = tuple[int, int]
Pose = tuple[float, float, float]
Twist = tuple[float, float]


class Parameters(NamedTuple):
    """The tunable values, in the order of dwa.DWA."""

    max_vel_x: float
    max_vel_theta: float
    vx_samples: float
    vtheta_samples: float
    occdist_scale: float
    pdist_scale: float
    gdist_scale: float
    inflation_radius: float


@dataclass(frozen=True)
class Costmap:
    """costs (rows, columns) uint8 and the world position, m, of its lower left corner."""

    costs: NDArray[np.uint8]
    resolution: float
    origin: tuple[float, float]

    def cell(self, x: float, y: float) -> Cell | None:
        """Column and row of a point; None off the map."""
        if x < self.origin[0] or y < self.origin[1]:
            return None
        mx, my = int((x - self.origin[0]) / self.resolution), int((y - self.origin[1]) / self.resolution)
        rows, columns = self.costs.shape
        return (mx, my) if mx < columns and my < rows else None

    def cost(self, cell: Cell) -> int:
        return int(self.costs[cell[1], cell[0]])


@dataclass(frozen=True)
class Sample:
    """One evaluated velocity: cost -1 hits something, -2 has no way to the goal; points (x, y, yaw)."""

    v: float
    w: float
    cost: float
    points: tuple[Pose, ...]


def line_cells(a: Cell, b: Cell) -> list[Cell]:
    """Cells of a line, both ends included (LineIterator)."""
    (x, y), (dx, dy) = a, (abs(b[0] - a[0]), abs(b[1] - a[1]))
    sx, sy = (1 if b[0] >= a[0] else -1), (1 if b[1] >= a[1] else -1)
    steep = dy > dx
    length, side = (dy, dx) if steep else (dx, dy)
    error, cells = length // 2, []
    for _ in range(length + 1):
        cells.append((x, y))
        error += side
        if error >= length:
            error -= length
            x, y = (x + sx, y) if steep else (x, y + sy)
        x, y = (x, y + sy) if steep else (x + sx, y)
    return cells


def wavefront(blocked: NDArray[np.bool_], targets: list[Cell]) -> NDArray[np.int64]:
    """4-neighbour distance to the targets: cells = an obstacle next to reached cells, cells + 1 = unreached."""
    rows, columns = blocked.shape
    distance = np.full(blocked.shape, blocked.size + 1, np.int64)
    seen = np.zeros(blocked.shape, bool)
    queue: deque[Cell] = deque()
    for x, y in targets:
        if not seen[y, x]:
            distance[y, x], seen[y, x] = 0, True
            queue.append((x, y))
    while queue:
        x, y = queue.popleft()
        for nx, ny in ((x - 1, y), (x + 1, y), (x, y - 1), (x, y + 1)):
            if not (0 <= nx < columns and 0 <= ny < rows) or seen[ny, nx]:
                continue
            seen[ny, nx] = True
            distance[ny, nx] = blocked.size if blocked[ny, nx] else distance[y, x] + 1
            if not blocked[ny, nx]:
                queue.append((nx, ny))
    return distance


def plan_cells(costmap: Costmap, plan: NDArray[np.float64]) -> list[Cell]:
    """Cells of the plan, densified to the map's resolution, until it leaves the map."""
    cells: list[Cell] = []
    last = plan[0]
    dense = [tuple(map(float, last))]
    for point in plan[1:]:
        dx, dy = float(point[0] - last[0]), float(point[1] - last[1])
        if dx * dx + dy * dy > costmap.resolution * costmap.resolution:
            steps = math.ceil(math.sqrt(dx * dx + dy * dy) / costmap.resolution)
            dense += [(float(last[0]) + j * (dx / steps), float(last[1]) + j * (dy / steps)) for j in range(1, steps)]
        dense.append(tuple(map(float, point)))
        last = point
    for x, y in dense:
        cell = costmap.cell(x, y)
        if cell is not None and costmap.cost(cell) != UNKNOWN:
            cells.append(cell)
        elif cells:
            break
    return cells


class TrajectoryScorer:
    """Scores every sample of one control cycle on one map and picks the winner."""

    def __init__(
        self, settings: PlannerSettings, parameters: Parameters, costmap: Costmap, plan: NDArray[np.float64]
    ) -> None:
        """`plan` (n, 2): the local plan, already cut and pruned."""
        self.settings, self.parameters, self.costmap, self.plan = settings, parameters, costmap, plan
        long = settings.half_length_m + settings.footprint_padding
        wide = settings.half_width_m + settings.footprint_padding
        self.corners = ((-long, -wide), (-long, wide), (long, wide), (long, -wide))
        scale = settings.resolution_m if settings.meter_scoring else 1.0
        self.pdist, self.gdist = parameters.pdist_scale * scale, parameters.gdist_scale * scale

    def best(self, pose: Pose, twist: Twist) -> Sample:
        """The chosen sample; `pose` and `twist` as truncated to float32 by the caller."""
        self._spread(pose)
        s, p = self.settings, self.parameters
        period, (v, w) = 1.0 / s.controller_frequency, twist
        reach = math.hypot(self.plan[-1, 0] - pose[0], self.plan[-1, 1] - pose[1]) / s.sim_time
        max_v = max(min(p.max_vel_x, reach, v + s.acc_lim_x * period), s.min_vel_x)
        min_v = max(s.min_vel_x, v - s.acc_lim_x * period)
        max_w = min(p.max_vel_theta, w + s.acc_lim_theta * period)
        min_w = max(-p.max_vel_theta, w - s.acc_lim_theta * period)
        nv, nw = int(p.vx_samples), int(p.vtheta_samples)
        dv = (max_v - min_v) / (nv - 1) if nv > 1 else math.inf
        dw = (max_w - min_w) / (nw - 1) if nw > 1 else math.inf
        best = self._forward(pose, twist, (min_v, dv, nv), (min_w, dw, nw))
        best = self._in_place(pose, twist, (min_w, dw, nw), best)
        if best is not None:
            return best
        escape = self.simulate(pose, twist, s.escape_vel, 0.0)
        return replace(escape, cost=1.0) if escape.cost == -1.0 else escape

    def _forward(
        self,
        pose: Pose,
        twist: Twist,
        speeds: tuple[float, float, int],
        rates: tuple[float, float, int],
    ) -> Sample | None:
        """First of the cheapest: for each speed straight ahead, then all yaw rates but the highest."""
        best: Sample | None = None
        v, dv, nv = speeds
        for _ in range(nv):
            w = rates[0]
            turns = [0.0]
            for _ in range(rates[2] - 1):
                turns.append(w)
                w += rates[1]
            for turn in turns:
                sample = self.simulate(pose, twist, v, turn)
                if sample.cost >= 0 and (best is None or sample.cost < best.cost):
                    best = sample
            v += dv
        return best

    def _in_place(
        self,
        pose: Pose,
        twist: Twist,
        rates: tuple[float, float, int],
        best: Sample | None,
    ) -> Sample | None:
        """Turns on the spot win ties, if they look at a cell nearer the goal than the turns before them."""
        ahead = math.inf
        w, dw, nw = rates
        least = self.settings.min_in_place_vel_theta
        for _ in range(nw):
            sample = self.simulate(pose, twist, 0.0, max(w, least) if w > 0 else min(w, -least))
            legal = sample.cost >= 0 and (best is None or sample.cost <= best.cost)
            if legal and (w > dw or w < -dw):
                x, y, yaw = sample.points[-1]
                lookahead = self.settings.heading_lookahead
                cell = self.costmap.cell(x + lookahead * math.cos(yaw), y + lookahead * math.sin(yaw))
                if cell is not None and self.goal[cell[1], cell[0]] < ahead:
                    best, ahead = sample, float(self.goal[cell[1], cell[0]])
            w += dw
        return best

    def _spread(self, pose: Pose) -> None:
        """Path and goal wavefronts; cells under the robot do not block the path's."""
        blocked = self.costmap.costs >= INSCRIBED
        cells = plan_cells(self.costmap, self.plan)
        self.goal = wavefront(blocked, cells[-1:])
        free = blocked.copy()
        outline = self._outline(*pose)
        for column in {x for x, _ in outline or ()}:
            rows = [y for x, y in outline or () if x == column]
            free[min(rows) : max(rows) + 1, column] = False
        self.path = wavefront(free, cells)

    def _outline(self, x: float, y: float, yaw: float) -> list[Cell] | None:
        """Cells of the padded footprint's outline; None when a corner is off the map."""
        c, s = math.cos(yaw), math.sin(yaw)
        corners = [self.costmap.cell(x + (cx * c - cy * s), y + (cx * s + cy * c)) for cx, cy in self.corners]
        known = [corner for corner in corners if corner is not None]
        if len(known) < len(corners):
            return None
        return [cell for a, b in zip(known, known[1:] + known[:1], strict=True) for cell in line_cells(a, b)]

    def simulate(self, pose: Pose, twist: Twist, v: float, w: float) -> Sample:
        """Roll one velocity out for sim_time and score it."""
        s = self.settings
        steps = int(max(abs(v) * s.sim_time / s.sim_granularity, abs(w) / s.angular_sim_granularity) + 0.5)
        dt = s.sim_time / max(steps, 1)
        (x, y, yaw), (speed, rate) = pose, twist
        path = goal = occ = 0.0
        points: list[Pose] = []
        for _ in range(max(steps, 1)):
            cell, outline = self.costmap.cell(x, y), self._outline(x, y, yaw)
            if cell is None or outline is None:
                return Sample(v, w, -1.0, tuple(points))
            worst = max(self.costmap.cost(c) for c in outline)
            if worst >= LETHAL:
                return Sample(v, w, -1.0, tuple(points))
            occ = max(occ, worst, self.costmap.cost(cell))
            path, goal = float(self.path[cell[1], cell[0]]), float(self.goal[cell[1], cell[0]])
            if max(path, goal) >= self.costmap.costs.size:
                return Sample(v, w, -2.0, tuple(points))
            points.append((x, y, yaw))
            speed = _towards(v, speed, s.acc_lim_x * dt)
            rate = _towards(w, rate, s.acc_lim_theta * dt)
            x, y, yaw = x + speed * math.cos(yaw) * dt, y + speed * math.sin(yaw) * dt, yaw + rate * dt
        cost = self.pdist * path + goal * self.gdist + self.parameters.occdist_scale * occ
        return Sample(v, w, cost, tuple(points))


def _towards(target: float, now: float, step: float) -> float:
    return min(target, now + step) if target - now >= 0 else max(target, now - step)
