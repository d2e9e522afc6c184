"""Figures of an evaluation and of a training run, as PNG and PDF.

Colours are Okabe and Ito's, which colour-blind readers tell apart; no figure needs colour alone: bars
also differ in sign, lines in dash. matplotlib is imported on first use and never opens a window.
"""

from __future__ import annotations

import contextlib
import io
import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from appl_dist.errors import UserError
from appl_dist.evaluate.analysis import DEFAULT, FIXED, Analysis
from appl_dist.files import write_atomic

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

BLUE, VERMILLION, GREY = "#0072B2", "#D55E00", "#B0B0B0"
LINES = (BLUE, "#009E73", "#CC79A7", "#E69F00", "#56B4E9")
BASELINE_STYLES = {DEFAULT: ("#000000", "--"), FIXED: (VERMILLION, "-.")}
WIDTH_IN = 7.0
STYLE: dict[Any, Any] = {
    "font.size": 9,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.axisbelow": True,
    "pdf.fonttype": 42,
}


def difference_figure(analysis: Analysis, method: str, versus: str) -> Figure:
    """Per world mean traversal time of `method` minus that of `versus`, sorted; coloured where p < 0.05.

    One panel a group of worlds, as in APPL journal Fig. 8.
    """
    figure, panels = _panels(len(analysis.groups), height_in=2.1)
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
            panel.bar(rank[chosen], difference_s[chosen], width=0.9, color=colour, label=label)
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


def ecdf_figure(analysis: Analysis) -> Figure:
    """Share of trials that have reached the goal by a time, per method; where it ends is the success rate."""
    figure, panels = _panels(len(analysis.groups), height_in=2.4)
    for panel, group in zip(panels, analysis.groups, strict=True):
        for method, (colour, style) in _method_styles(analysis.methods).items():
            s = analysis.samples[method]
            times_s = np.sort(np.concatenate([s.times_s[w] for w in group.worlds]))
            reached_s = times_s[times_s < analysis.failed_time_s]
            steps_s = np.concatenate([[0.0], reached_s, [analysis.limit_s]])
            share = np.append(np.arange(len(reached_s) + 1), len(reached_s)) / len(times_s)
            panel.step(steps_s, share, where="post", color=colour, linestyle=style, linewidth=1.5, label=method)
        panel.set_xlim(0.0, analysis.limit_s)
        panel.set_ylim(0.0, 1.02)
        panel.grid(color="#E0E0E0", linewidth=0.6)
        panel.set_ylabel("share at the goal")
        panel.set_title(f"{group.name}: {len(group.worlds)} worlds", loc="left", fontsize=9)
    panels[0].legend(loc="upper left", fontsize=8, frameon=False)
    panels[-1].set_xlabel("traversal time, s")
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
    figure, (above, below) = _panels(2, height_in=2.0, share_x=True)
    for panel, values, name in ((above, time_s, "traversal time, s"), (below, success, "success")):
        panel.plot(transitions, values, color=BLUE, linewidth=1.5, label="while training, with exploration noise")
        for label, pair in baselines.items():
            colour, style = BASELINE_STYLES.get(label, (LINES[1], ":"))
            value = pair[0] if panel is above else pair[1]
            panel.axhline(value, color=colour, linestyle=style, linewidth=1.1, label=label)
        panel.grid(color="#E0E0E0", linewidth=0.6)
        panel.set_ylabel(name)
    below.set_ylim(0.0, 1.02)
    below.set_xlim(0.0, float(np.max(transitions)))
    below.xaxis.set_major_formatter(lambda value, _: f"{value:,.0f}")
    above.legend(loc="upper right", fontsize=8, frameon=False)
    below.set_xlabel("transitions in replay")
    return figure


def read_metrics(path: str | Path) -> tuple[NDArray[Any], NDArray[Any], NDArray[Any]]:
    """Arrays for `learning_figure` from a training run's metrics.jsonl: transitions, time_s and success.

    Reads its entries episode/time_s and episode/success: running means, in which failures count already. A last
    line cut short is skipped.
    """
    try:
        lines = Path(path).read_text().splitlines()
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


def save_figure(figure: Figure, path: Path) -> list[Path]:
    """Write `path`.png and `path`.pdf; the same figure gives the same bytes."""
    import matplotlib

    written = []
    for kind, metadata in (("png", {"Software": None}), ("pdf", {"CreationDate": None})):
        data = io.BytesIO()
        with matplotlib.rc_context(STYLE):
            figure.savefig(data, format=kind, dpi=160, metadata=metadata)
        file = path.with_name(f"{path.name}.{kind}")
        write_atomic(file, data.getvalue())
        written.append(file)
    return written


def _panels(count: int, height_in: float, share_x: bool = False) -> tuple[Figure, Sequence[Axes]]:
    import matplotlib
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    with matplotlib.rc_context(STYLE):
        figure = Figure(figsize=(WIDTH_IN, 0.6 + height_in * count), layout="constrained")
        FigureCanvasAgg(figure)
        axes = figure.subplots(count, 1, squeeze=False, sharex=share_x)
    return figure, list(axes[:, 0])


def _method_styles(methods: Sequence[str]) -> dict[str, tuple[str, str]]:
    others = [m for m in methods if m not in BASELINE_STYLES]
    own = {m: (LINES[i % len(LINES)], "-") for i, m in enumerate(others)}
    return {m: BASELINE_STYLES[m] if m in BASELINE_STYLES else own[m] for m in methods}
