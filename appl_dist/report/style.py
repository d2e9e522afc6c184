"""How figures look, and how they are written.

Colours are Okabe and Ito's, which colour-blind readers tell apart; no figure needs colour alone: bars also differ in
sign, lines in dash, points in shape. Sizes are those of a paper's full width, so text is 8 or 9 point in print.
matplotlib is imported on first use and never opens a window.
"""

from __future__ import annotations

import io
import os
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from appl_dist.errors import UserError
from appl_dist.evaluate.analysis import DEFAULT, FIXED
from appl_dist.files import write_atomic

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

BLUE, VERMILLION, GREY = "#0072B2", "#D55E00", "#B0B0B0"
LINES = (BLUE, "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#F0E442")
MARKERS = ("o", "s", "^", "D", "v", "P")
DASHES: tuple[Any, ...] = ("-", (0, (5, 1)), (0, (3, 1, 1, 1)), (0, (1, 1)), (0, (7, 2)), (0, (5, 1, 1, 1, 1, 1)))
BASELINE_STYLES: dict[str, tuple[str, Any, str]] = {
    DEFAULT: ("#000000", "--", "x"),
    FIXED: (VERMILLION, "-.", "+"),
}
WIDTH_IN = 7.0
STYLE: dict[Any, Any] = {
    "font.size": 9,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.axisbelow": True,
    "pdf.fonttype": 42,
}
PNG_DPI = 160


def stacked(count: int, height_in: float, share_x: bool = False) -> tuple[Figure, Sequence[Axes]]:
    """A figure of `count` panels above each other."""
    figure = new_figure(0.6 + height_in * count)
    axes = figure.subplots(count, 1, squeeze=False, sharex=share_x)
    return figure, list(axes[:, 0])


def new_figure(height_in: float, width_in: float = WIDTH_IN) -> Figure:
    os.environ["MPLBACKEND"] = "agg"  # a notebook's, or a wrong one, would stop the import; no window is ever opened
    try:
        os.environ["MPLBACKEND"] = "agg"  # what a notebook has set there may not be importable here
        import matplotlib
        from matplotlib.backends.backend_agg import FigureCanvasAgg
        from matplotlib.figure import Figure
    except ImportError:
        raise UserError("figures need matplotlib: pip install 'appl-dist[evaluate]'") from None

    matplotlib.rcParams.update(STYLE)
    figure = Figure(figsize=(width_in, height_in), layout="constrained")
    FigureCanvasAgg(figure)
    return figure


def method_styles(methods: Sequence[str]) -> dict[str, tuple[str, Any, str]]:
    """Colour, dash and marker of every method: the baselines always the same."""
    others = [m for m in methods if m not in BASELINE_STYLES]
    own = {
        m: (LINES[i % len(LINES)], DASHES[(i + i // len(LINES)) % len(DASHES)], MARKERS[i % len(MARKERS)])
        for i, m in enumerate(others)
    }
    return {m: BASELINE_STYLES[m] if m in BASELINE_STYLES else own[m] for m in methods}


def png_bytes(figure: Figure, dpi: int = PNG_DPI) -> bytes:
    """The same figure gives the same bytes."""
    data = io.BytesIO()
    figure.savefig(data, format="png", dpi=dpi, metadata={"Software": None})
    return data.getvalue()


def save_figure(figure: Figure, path: Path) -> list[Path]:
    """Write `path`.png and `path`.pdf."""
    png, pdf = png_bytes(figure), io.BytesIO()
    figure.set_layout_engine("none")  # laid out by now
    figure.savefig(pdf, format="pdf", dpi=300, metadata={"CreationDate": None})
    written = []
    for kind, data in (("png", png), ("pdf", pdf.getvalue())):
        file = path.with_name(f"{path.name}.{kind}")
        write_atomic(file, data)
        written.append(file)
    return written
