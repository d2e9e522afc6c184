"""Figures of single trials: the way through a world, what was seen and planned at a moment, parameters on the way.

Everything is in the world frame, metres, x right, y forward.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from appl_dist.evaluate.trial_replay import Frame, Recording, trial_name
from appl_dist.report.style import BLUE, LINES, VERMILLION, new_figure
from appl_dist.sim.worlds import World

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

SPEED = "speed"
HULL_M = (0.508, 0.430)  # length and width of the chassis
LETHAL, INSCRIBED = 254, 253
COLOUR_MAP = "viridis"  # even in lightness: readable in grey and by the colour-blind


def path_values(recording: Recording, what: str) -> tuple[NDArray[np.float64], str]:
    """(n,) values along the trajectory's samples, and their label: `speed`, or a planner parameter's name."""
    t = recording.result.trajectory
    if what == SPEED:
        return np.abs(t[:, 4]), "speed, m/s"
    values = recording.result.parameters[:, recording.names.index(what)]
    return values[decision_of(recording)], what


def decision_of(recording: Recording) -> NDArray[np.int64]:
    """(n,) index of the decision in force at each sample of the trajectory."""
    t_s = recording.result.trajectory[:, 0]
    n = len(recording.result.parameters)
    return np.clip(np.ceil(t_s / recording.period_s - 1e-9).astype(np.int64) - 1, 0, n - 1)


def map_figure(recordings: Sequence[Recording], what: str = SPEED, columns: int = 4) -> Figure:
    """One map a recording, in rows of at most `columns`, the path coloured by `what`, on a common scale."""
    rows = -(-len(recordings) // columns)
    figure = new_figure(2.7 * rows + 0.2)
    panels = figure.subplots(rows, -(-len(recordings) // rows), squeeze=False).ravel()  # rows as even as they go
    values = [path_values(r, what) for r in recordings]
    if what == SPEED:
        limits = 0.0, max((float(v.max()) for v, _ in values), default=1.0) or 1.0
    else:  # all that the parameter may be, so that what hardly varies does not seem to
        k = recordings[0].names.index(what)
        limits = min(float(r.low[k]) for r in recordings), max(float(r.high[k]) for r in recordings)
    line = None
    for panel, recording, (v, _) in zip(panels, recordings, values, strict=False):
        draw_world(panel, recording)
        line = draw_path(panel, recording, v, limits)
        t = recording.trial
        panel.set_title(f"{trial_name(t)}\n{t.outcome}, {t.time_s:.1f} s\n{t.distance_m:.1f} m", fontsize=7)
    for panel in panels[len(recordings) :]:
        panel.set_axis_off()
    if line is not None:
        bar = figure.colorbar(line, ax=list(panels), label=values[0][1], shrink=0.7, pad=0.01, aspect=30)
        bar.ax.tick_params(labelsize=7)
    figure.supxlabel("x, m", fontsize=8)
    figure.supylabel("y, m", fontsize=8)
    return figure


def inset_figure(recording: Recording, frame: Frame, what: str = SPEED) -> Figure:
    """A trial's map and, at the moment of `frame`, the lidar's view and the local costmap with plan and roll-out."""
    figure = new_figure(3.3)
    figure.set_layout_engine("compressed")
    overview, lidar, costs = figure.subplots(1, 3, width_ratios=(0.75, 1.0, 1.0))  # all about equally high
    values, label = path_values(recording, what)
    draw_world(overview, recording)
    line = draw_path(overview, recording, values, (float(values.min()), max(float(values.max()), 1e-9)))
    bar = figure.colorbar(line, ax=overview, label=label, shrink=0.6, pad=0.02)
    bar.ax.tick_params(labelsize=7)
    t = recording.trial
    overview.set_title(f"{trial_name(t)}: {t.outcome}, {t.time_s:.1f} s", fontsize=8)
    draw_hull(overview, frame.pose, VERMILLION)
    for panel, title in ((lidar, f"lidar at {frame.t_s:.1f} s"), (costs, f"local costmap at {frame.t_s:.1f} s")):
        panel.set_title(title, fontsize=8)
        x, y, _ = frame.pose
        panel.set(xlim=(x - 1.5, x + 1.5), ylim=(y - 1.2, y + 2.4), aspect="equal")
        panel.tick_params(labelsize=7)
    draw_cylinders(lidar, recording.world, "#DDDDDD")
    points = recording.scan_points(frame)
    lidar.plot(*points.T, ".", color=VERMILLION, markersize=2, label="beam ends")
    high = frame.costmap_origin + recording.resolution_m * np.array(frame.costmap.shape[::-1])
    extent = (frame.costmap_origin[0], high[0], frame.costmap_origin[1], high[1])
    shown = np.ma.masked_equal(frame.costmap.astype(float), 0.0)
    costs.imshow(shown, origin="lower", extent=extent, cmap="Greys", vmin=0, vmax=LETHAL, interpolation="nearest")
    for panel in (lidar, costs):
        panel.plot(*frame.plan.T, color="#009E73", linewidth=1.3, label="global plan")
        panel.plot(*frame.trajectory.T, color=BLUE, linewidth=2.0, label="chosen roll-out")
        draw_hull(panel, frame.pose, BLUE)
    overview.set_ylabel("y, m", fontsize=8)
    for panel in (overview, lidar, costs):
        panel.set_xlabel("x, m", fontsize=8)
    figure.legend(*lidar.get_legend_handles_labels(), loc="outside lower right", ncols=3, fontsize=7, frameon=False)
    return figure


def parameter_figure(recording: Recording) -> Figure:
    """Speed and all parameters against time, decisions dashed, as ICRA 2021 Fig. 4."""
    names = recording.names
    figure = new_figure(0.5 + 0.62 * (len(names) + 1))
    panels = figure.subplots(len(names) + 1, 1, sharex=True)
    t = recording.result.trajectory
    panels[0].plot(t[:, 0], t[:, 4], color="black", linewidth=1.0)
    panels[0].set_ylabel("speed\nm/s", fontsize=7, rotation=0, ha="right", va="center")
    times_s = recording.period_s * np.arange(len(recording.result.parameters) + 1)
    times_s[-1] = max(t[-1, 0], times_s[-2])
    for k, (name, panel) in enumerate(zip(names, panels[1:], strict=True)):
        values = recording.result.parameters[:, k]
        panel.stairs(values, times_s, color=LINES[0], linewidth=1.5, baseline=None)
        margin = 0.08 * (recording.high[k] - recording.low[k])
        panel.set_ylim(recording.low[k] - margin, recording.high[k] + margin)
        panel.set_ylabel(name, fontsize=7, rotation=0, ha="right", va="center")
    for panel in panels:
        for at in times_s[1:-1]:
            panel.axvline(at, color="#CCCCCC", linewidth=0.6, linestyle="--", zorder=0)
        panel.tick_params(labelsize=6.5)
    panels[-1].set_xlim(0.0, times_s[-1])
    panels[-1].set_xlabel("simulated time, s")
    trial = recording.trial
    panels[0].set_title(f"{trial_name(trial)}: {trial.outcome}, {trial.time_s:.1f} s", loc="left", fontsize=9)
    return figure


def draw_world(panel: Axes, recording: Recording) -> None:
    """Obstacles, the reference path, and as much of the world as was driven through."""
    draw_cylinders(panel, recording.world, "0.3")
    panel.plot(*recording.world.path.T, color="#CC79A7", linewidth=0.8, linestyle=":")
    way = recording.result.trajectory[:, 2]
    panel.set(xlim=(-4.8, 0.3), ylim=(way.min() - 0.6, max(way.max() + 0.4, 9.8)), aspect="equal")
    panel.tick_params(labelsize=6.5)


def draw_cylinders(panel: Axes, world: World, colour: str) -> None:
    from matplotlib.collections import EllipseCollection

    size = 2.0 * world.cylinders[:, 2]  # one shape at many places: far quicker to draw than a patch each
    discs = EllipseCollection(
        size,
        size,
        0.0,
        units="xy",
        offsets=world.cylinders[:, :2],
        offset_transform=panel.transData,
        color=colour,
        lw=0,
    )
    panel.add_collection(discs)


def draw_path(panel: Axes, recording: Recording, values: NDArray[np.float64], limits: tuple[float, float]) -> Any:
    """The trajectory, coloured, thin samples left out; returns what a colour bar needs."""
    from matplotlib.collections import LineCollection
    from matplotlib.colors import Normalize

    t = recording.result.trajectory[::5]
    points = t[:, 1:3]
    segments = np.stack([points[:-1], points[1:]], axis=1)
    line = LineCollection(list(segments), cmap=COLOUR_MAP, norm=Normalize(*limits), linewidths=1.8)
    line.set_array(values[::5][:-1])
    panel.add_collection(line)
    panel.plot(*recording.result.trajectory[0, 1:3], "o", color="black", markersize=3)
    end = recording.result.trajectory[-1, 1:3]
    panel.plot(*end, "*" if recording.trial.success else "X", color=VERMILLION, markersize=7, markeredgecolor="white")
    return line


def draw_hull(panel: Axes, pose: NDArray[np.float64], colour: str) -> None:
    panel.plot(*hull(pose).T, color=colour, linewidth=1.4)


def hull(pose: NDArray[np.float64]) -> NDArray[np.float64]:
    """(5, 2) closed outline of the chassis at a pose (3,)."""
    length, width = HULL_M
    x, y, yaw = pose
    corners = 0.5 * np.array([(length, width), (-length, width), (-length, -width), (length, -width), (length, width)])
    turn = np.array([(np.cos(yaw), np.sin(yaw)), (-np.sin(yaw), np.cos(yaw))])
    outline: NDArray[np.float64] = corners @ turn + (x, y)
    return outline
