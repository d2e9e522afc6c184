"""`appl-dist report RUN…`: tables, figures and one page of evaluations.

Writes report.html, tables.md, tables.tex, tables/*.csv, figures/*.pdf, .png and .gif.
"""

from __future__ import annotations

import importlib.util
import logging
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from rich.console import Console

from appl_dist.evaluate.trial_replay import OpenEnv
from appl_dist.files import write_atomic
from appl_dist.report.data import ReportData, gather
from appl_dist.report.page import Shown, render
from appl_dist.report.pictures import Replays
from appl_dist.report.table import Table
from appl_dist.report.tables import all_tables

log = logging.getLogger(__name__)


@dataclass(frozen=True)
class Report:
    data: ReportData
    tables: tuple[Table, ...]
    folder: Path


def write_report(runs: Sequence[Path], folder: Path, open_env: OpenEnv | None = None, pictures: bool = True) -> Report:
    """Read the evaluations in `runs` and write their report into `folder`. Raises UserError.

    open_env: makes the environment of an evaluation, for replays; without it the page has none. pictures: False
    writes the tables alone.
    """
    data = gather(runs)
    tables = all_tables(data.analysis, data.courses, data.protocol.metric, data.caveats)
    for table in tables:
        write_atomic(folder / "tables" / f"{table.name}.csv", table.csv())
    write_atomic(folder / "tables.md", "\n".join(t.markdown() for t in tables))
    write_atomic(folder / "tables.tex", "\n".join(t.latex() for t in tables))
    if not pictures:
        return Report(data, tuple(tables), folder)
    try:
        shown, replays = _pictures(data, folder / "figures", open_env)
    except Exception as error:  # what draws is a large library with an environment of its own; numbers are kept
        log.warning("no figures: %s: %s; trials and tables are in %s", type(error).__name__, error, folder)
        log.debug("drawing failed", exc_info=True)
        shown, replays = [], Replays()
    write_atomic(folder / "report.html", render(data, tables, shown, replays))
    return Report(data, tuple(tables), folder)


def _pictures(data: ReportData, folder: Path, open_env: OpenEnv | None) -> tuple[list[Shown], Replays]:
    if importlib.util.find_spec("matplotlib") is None:
        log.warning("no figures: matplotlib is not installed (pip install 'appl-dist[evaluate]')")
        return [], Replays()
    from appl_dist.report.pictures import replay_pictures, statistics_pictures
    from appl_dist.report.style import save_figure

    replays = replay_pictures(data, open_env) if open_env else Replays()
    if replays.missing:
        log.warning("no replays: %s", replays.missing)
    shown = []
    for picture in (*statistics_pictures(data), *replays.pictures):
        png, _ = save_figure(picture.figure, folder / picture.name)
        shown.append(Shown(picture.name, picture.caption, png.read_bytes()))
    for film in replays.films:
        write_atomic(folder / f"{film.name}.gif", film.gif)
    return shown, replays


def print_tables(report: Report, console: Console) -> None:
    """The tables that say who is better."""
    for table in report.tables:
        if table.name in ("score", "mean", "wins"):
            console.print(table.rich())
    console.print(f"trials, tables and report in {report.folder}", highlight=False, markup=False)
