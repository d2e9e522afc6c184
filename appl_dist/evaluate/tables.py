"""The two tables of the papers, for terminals, Markdown and CSV.

`mean_table` is APPL journal Tab. V: mean traversal time and the improvement over the baselines.
`wins_table` is Tab. VI: in how many worlds a method is significantly better and worse than another.
"""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

from rich import box
from rich.table import Table as RichTable

from appl_dist.evaluate.analysis import Analysis, Group

Record = dict[str, Any]


@dataclass(frozen=True)
class Column:
    """A heading and how a record reads under it; the record's own values go to CSV."""

    heading: str
    text: Callable[[Record], str]
    left: bool = False


@dataclass(frozen=True)
class Table:
    title: str
    note: str
    columns: tuple[Column, ...]
    records: tuple[Record, ...]

    def rich(self) -> RichTable:
        view = RichTable(title=self.title, caption=self.note, box=box.SIMPLE_HEAD, caption_justify="left")
        for c in self.columns:
            view.add_column(c.heading, justify="left" if c.left else "right")
        for i, record in enumerate(self.records):
            last = i + 1 < len(self.records) and self.records[i + 1]["worlds"] != record["worlds"]
            view.add_row(*(c.text(record) for c in self.columns), end_section=last)
        return view

    def markdown(self) -> str:
        lines = [f"**{self.title}**", "", _row(c.heading for c in self.columns)]
        lines.append(_row("---" if c.left else "---:" for c in self.columns))
        lines += [_row(c.text(record).replace("|", "\\|") for c in self.columns) for record in self.records]
        return "\n".join([*lines, "", self.note, ""])

    def csv(self) -> str:
        text = io.StringIO()
        writer = csv.DictWriter(text, list(self.records[0]) if self.records else [], lineterminator="\n")
        writer.writeheader()
        writer.writerows(self.records)
        return text.getvalue()


def mean_table(analysis: Analysis) -> Table:
    """Mean traversal time per group and method, success, and improvement over each baseline present."""
    records = tuple(_mean_record(analysis, g, m) for g in analysis.groups for m in analysis.methods)
    columns = [
        Column("worlds", lambda r: f"{r['worlds']} ({r['world_count']})", left=True),
        Column("method", lambda r: str(r["method"]), left=True),
        Column("time, s", lambda r: _number(r["mean_time_s"])),
        Column("success, % [95 %]", _success),
    ]
    for base in analysis.baselines:
        columns.append(Column(f"faster than {base}, s [95 %]", partial(_improvement, base=base)))
    failed, limit = analysis.failed_time_s, analysis.limit_s
    note = f"Mean over worlds of the mean of trials; a failed trial (limit {limit:g} s) counts {failed:g} s."
    return Table("Mean traversal time", note, tuple(columns), records)


def wins_table(analysis: Analysis) -> Table:
    """Worlds with a significant difference, for every pair of methods; baselines are the opponents."""
    order = sorted(analysis.methods, key=lambda m: m not in analysis.baselines)
    pairs = [(m, other) for j, m in enumerate(order) for other in order[:j]]
    records = tuple(_wins_record(g, m, other) for g in analysis.groups for m, other in pairs)
    columns = (
        Column("worlds", lambda r: f"{r['worlds']} ({r['world_count']})", left=True),
        Column("method", lambda r: str(r["method"]), left=True),
        Column("versus", lambda r: str(r["versus"]), left=True),
        Column("better", lambda r: _share(r["better"], r["world_count"])),
        Column("worse", lambda r: _share(r["worse"], r["world_count"])),
    )
    note = "Worlds where mean traversal times differ with p < 0.05 (Welch's t-test, each world by itself)."
    return Table("Worlds significantly better or worse", note, columns, records)


def _mean_record(analysis: Analysis, group: Group, method: str) -> Record:
    s = group.summaries[method]
    record: Record = {
        "worlds": group.name,
        "world_count": s.worlds,
        "method": method,
        "trials": s.trials,
        "mean_time_s": s.mean_time_s,
        "success": s.success,
        "success_low": s.success_low,
        "success_high": s.success_high,
    }
    for base in analysis.baselines:
        c = group.comparisons.get((method, base))
        record |= {
            f"improvement_over_{base}_s": None if c is None else c.improvement_s,
            f"improvement_over_{base}_low_s": None if c is None else c.improvement_low_s,
            f"improvement_over_{base}_high_s": None if c is None else c.improvement_high_s,
            f"improvement_over_{base}_percent": None if c is None else c.improvement_percent,
        }
    return record


def _wins_record(group: Group, method: str, versus: str) -> Record:
    c = group.comparisons[method, versus]
    n = len(c.worlds)
    return {
        "worlds": group.name,
        "world_count": n,
        "method": method,
        "versus": versus,
        "better": c.better,
        "better_percent": 100.0 * c.better / n,
        "worse": c.worse,
        "worse_percent": 100.0 * c.worse / n,
    }


def _success(r: Record) -> str:
    return f"{100 * r['success']:.1f} [{100 * r['success_low']:.1f}, {100 * r['success_high']:.1f}]"


def _improvement(r: Record, base: str) -> str:
    gain_s = r[f"improvement_over_{base}_s"]
    if gain_s is None:
        return ""
    low_s, high_s = r[f"improvement_over_{base}_low_s"], r[f"improvement_over_{base}_high_s"]
    percent = r[f"improvement_over_{base}_percent"]
    return f"{gain_s:.2f} ({percent:.1f} %) [{_number(low_s)}, {_number(high_s)}]"


def _share(count: int, total: int) -> str:
    return f"{count} ({100.0 * count / total:.1f} %)"


def _number(value: float) -> str:
    return "–" if math.isnan(value) else f"{value:.2f}"


def _row(cells: Sequence[str] | Any) -> str:
    return "| " + " | ".join(cells) + " |"
