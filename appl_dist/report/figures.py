"""Figures of an evaluation and of a training run."""

from __future__ import annotations

import contextlib
import json
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from appl_dist.errors import UserError
from appl_dist.evaluate.analysis import Analysis, Group
from appl_dist.evaluate.statistics import performance_profile
from appl_dist.report.style import BASELINE_STYLES, BLUE, GREY, LINES, VERMILLION, method_styles, stacked

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


def difference_figure(analysis: Analysis, method: str, versus: str) -> Figure:
    """Per world mean traversal time of `method` minus that of `versus`, sorted; coloured where p < 0.05.

    One panel a group of worlds, as in APPL journal Fig. 8.
    """
    figure, panels = stacked(len(analysis.groups), height_in=2.1)
    for panel, group in zip(panels, analysis.groups, strict=True):
        c = group.comparisons[method, versus]
        order = np.argsort(c.difference_s, kind="stable")
        difference_s, significant = c.difference_s[order], c.significant[order]
        kinds = (
            (significant & (difference_s < 0), BLUE, f"{method} significantly faster: {c.better}"),
            (~significant, GREY, f"no significant difference: {len(order) - c.better - c.worse}"),
            (significant & (difference_s > 0), VERMILLION, f"{method} significantly slower: {c.worse}"),
        )
        rank = np.arange(1, len(order) + 1)
        for chosen, colour, label in kinds:
            panel.bar(
                rank[chosen], difference_s[chosen], width=0.9, color=colour, label=label if chosen.any() else None
            )
            if not chosen.any():
                panel.plot([], [], "s", color=colour, markersize=8, label=label)
        panel.axhline(0.0, color="black", linewidth=0.6)
        panel.axhline(
            -c.improvement_s,
            color="black",
            linewidth=0.9,
            linestyle=":",
            label=f"mean: {-c.improvement_s:+.2f} s",
        )
        panel.set_xlim(0.0, len(order) + 1.0)
        panel.set_ylabel(f"{method} − {versus}, s")
        panel.set_title(f"{group.name}: {len(order)} worlds", loc="left", fontsize=9)
        mostly_faster = -difference_s[0] > difference_s[-1]  # the emptier corner of a sorted row of bars
        panel.legend(loc="lower right" if mostly_faster else "upper left", fontsize=8, frameon=False)
    panels[-1].set_xlabel("worlds, ordered by difference of mean traversal time")
    return figure


def _share_axes(panel: Axes, group: Group, share_of: str, left: float, right: float) -> None:
    """A panel of cumulative shares, from 0 to 1 with a little room for lines at 1."""
    panel.set_xlim(left, right)
    panel.set_ylim(0.0, 1.02)
    panel.grid(color="#E0E0E0", linewidth=0.6)
    panel.set_ylabel(share_of)
    panel.set_title(f"{group.name}: {len(group.worlds)} worlds", loc="left", fontsize=9)


def ecdf_figure(analysis: Analysis) -> Figure:
    """Share of trials that have reached the goal by a time, per method; where it ends is the success rate."""
    figure, panels = stacked(len(analysis.groups), height_in=2.4)
    for panel, group in zip(panels, analysis.groups, strict=True):
        for method, (colour, style, _) in method_styles(analysis.methods).items():
            s = analysis.samples[method]
            times_s = np.sort(np.concatenate([s.times_s[w] for w in group.worlds]))
            reached_s = times_s[times_s < analysis.failed_time_s]
            steps_s = np.concatenate([[0.0], reached_s, [analysis.limit_s]])
            share = np.append(np.arange(len(reached_s) + 1), len(reached_s)) / len(times_s)
            panel.step(steps_s, share, where="post", color=colour, linestyle=style, linewidth=1.5, label=method)
        _share_axes(panel, group, "share at the goal", 0.0, analysis.limit_s)
    panels[0].legend(loc="upper left", fontsize=8, frameon=False)
    panels[-1].set_xlabel("traversal time, s")
    return figure


def times_figure(analysis: Analysis) -> Figure:
    """Mean traversal time of every world, worlds ordered by the mean over methods, with fits, as ICRA 2021 Fig. 5.

    Ordering by all methods together favours none; the fits are least squares over the order.
    """
    figure, found = stacked(len(analysis.groups), height_in=2.4)
    for panel, group in zip(found, analysis.groups, strict=True):
        means = np.array([[analysis.samples[m].times_s[w].mean() for w in group.worlds] for m in analysis.methods])
        order = np.argsort(means.mean(axis=0), kind="stable")
        rank = np.arange(1, len(order) + 1)
        for (method, (colour, dash, marker)), values in zip(
            method_styles(analysis.methods).items(), means, strict=True
        ):
            panel.plot(rank, values[order], marker, color=colour, markersize=3.5, markeredgewidth=0.9, alpha=0.85)
            label = f"{method}: mean {values.mean():.1f} s"
            if len(rank) > 1:
                panel.plot(rank, np.polyval(np.polyfit(rank, values[order], 1), rank), color=colour, linestyle=dash)
            panel.plot([], [], color=colour, linestyle=dash, marker=marker, markersize=4, label=label)
        panel.axhline(analysis.failed_time_s, color=GREY, linewidth=0.7, linestyle=":")
        panel.set_ylim(0.0, 1.2 * float(means.max()))  # room for the legend
        panel.set_xlim(0.0, len(order) + 1.0)
        panel.grid(axis="y", color="#E0E0E0", linewidth=0.6)
        panel.set_ylabel("mean traversal time, s")
        panel.set_title(f"{group.name}: {len(order)} worlds", loc="left", fontsize=9)
        panel.legend(loc="upper left", fontsize=8, frameon=False)
    found[-1].set_xlabel("worlds, ordered by the mean over methods")
    return figure


def profile_figure(analysis: Analysis) -> Figure:
    """Performance profiles: share of worlds a method crosses within a factor of the best method's mean time."""
    figure, found = stacked(len(analysis.groups), height_in=2.2)
    ratios = np.linspace(1.0, 5.0, 401)
    for panel, group in zip(found, analysis.groups, strict=True):
        means = np.array([[analysis.samples[m].times_s[w].mean() for w in group.worlds] for m in analysis.methods])
        shares = performance_profile(means, ratios)
        for (method, (colour, dash, _)), share in zip(method_styles(analysis.methods).items(), shares, strict=True):
            panel.step(ratios, share, where="post", color=colour, linestyle=dash, linewidth=1.5, label=method)
        _share_axes(panel, group, "share of worlds", 1.0, ratios[-1])
    found[0].legend(loc="lower right", fontsize=8, frameon=False)
    found[-1].set_xlabel("mean traversal time / that of the world's fastest method")
    return figure


def learning_figure(
    transitions: NDArray[Any],
    time_s: NDArray[Any],
    success: NDArray[Any],
    baselines: Mapping[str, tuple[float, float]],
) -> Figure:
    """Traversal time and success while training against transitions, all (n,): running means of episodes.

    `baselines`: label to (mean traversal time in s, success), drawn as lines; as in the running means, a
    failure counts the protocol's `failed_time_s` in the times.
    """
    figure, (above, below) = stacked(2, height_in=2.0, share_x=True)
    for panel, values, name in ((above, time_s, "traversal time, s"), (below, success, "success")):
        panel.plot(transitions, values, color=BLUE, linewidth=1.5, label="while training, with exploration noise")
        for label, pair in baselines.items():
            colour, style, _ = BASELINE_STYLES.get(label, (LINES[1], ":", ""))
            value = pair[0] if panel is above else pair[1]
            panel.axhline(value, color=colour, linestyle=style, linewidth=1.1, label=label)
        panel.grid(color="#E0E0E0", linewidth=0.6)
        panel.set_ylabel(name)
    below.set_ylim(0.0, 1.02)
    below.set_xlim(0.0, float(np.max(transitions)))
    below.xaxis.set_major_formatter(lambda value, _: f"{value:,.0f}")
    below.legend(loc="lower right", fontsize=8, frameon=False)  # where success is not
    below.set_xlabel("transitions in replay")
    return figure


def read_metrics(path: str | Path) -> tuple[NDArray[Any], NDArray[Any], NDArray[Any]]:
    """Arrays for `learning_figure` from a training run's metrics.jsonl: transitions, time_s and success.

    Reads its entries episode/time_s and episode/success: running means, in which failures count already. A last
    line cut short is skipped.
    """
    try:
        lines = Path(path).read_text("utf-8").splitlines()
    except OSError as error:
        raise UserError(f"{path}: {error.strerror}; give the metrics.jsonl of a training run") from None
    rows = []
    for line in lines:
        with contextlib.suppress(ValueError, KeyError, TypeError):
            record = json.loads(line)
            rows.append(tuple(float(record[k]) for k in ("step", "episode/time_s", "episode/success")))
    if not rows:
        raise UserError(f"{path}: has no line with episode/time_s and episode/success; nothing to draw")
    transitions, time_s, success = np.array(sorted(rows, key=lambda r: r[0])).T
    return transitions, time_s, success
