"""`appl-dist report RUN…`: tables, figures and one page of evaluations.

Writes report.html, tables.md, tables.tex, tables/*.csv, figures/*.pdf and .png.
"""

from __future__ import annotations

import logging
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from rich.console import Console

from appl_dist.evaluate.replay import OpenEnv
from appl_dist.files import write_atomic
from appl_dist.report.data import ReportData, gather
from appl_dist.report.table import Table
from appl_dist.report.tables import all_tables

log = logging.getLogger(__name__)


@dataclass(frozen=True)
class Report:
    data: ReportData
    tables: tuple[Table, ...]
    folder: Path


def write_report(runs: Sequence[Path], folder: Path, open_env: OpenEnv | None = None) -> Report:
    """Read the evaluations in `runs` and write their report into `folder`. Raises UserError.

    open_env: makes the environment of an evaluation, for replays; without it the page has none.
    """
    data = gather(runs)
    tables = all_tables(data.analysis, data.courses, data.protocol.metric)
    for table in tables:
        write_atomic(folder / "tables" / f"{table.name}.csv", table.csv())
    write_atomic(folder / "tables.md", "\n".join(t.markdown() for t in tables))
    write_atomic(folder / "tables.tex", "\n".join(t.latex() for t in tables))
    return Report(data, tuple(tables), folder)


def print_tables(report: Report, console: Console) -> None:
    """The tables that say who is better."""
    for table in report.tables:
        if table.name in ("score", "mean", "wins"):
            console.print(table.rich())
    console.print(f"trials, tables and figures in {report.folder}", highlight=False)
