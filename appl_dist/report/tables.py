"""The papers' tables of an analysis.

mean: APPL journal Tab. V. wins: Tab. VI. matrix: APPLI Tab. IV and APPLE Tab. III. thirds: ICRA 2021 Tab. III. sets:
BARN's twelve generation sets. difficulty: BARN's five metrics. score: BARN Challenge. driving: what times do not show.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial

from appl_dist.evaluate.analysis import Analysis, Group
from appl_dist.evaluate.breakdown import challenge_scores, difficulty, generation_sets, thirds
from appl_dist.evaluate.folder import Course
from appl_dist.report.table import Column, Record, Table


def all_tables(
    analysis: Analysis, courses: Mapping[int, Course], metric: str, caveats: tuple[str, ...] = ()
) -> list[Table]:
    """Every table that `analysis` has the data for; `metric` is the protocol's. caveats: stand in each."""
    tables = [score_table(analysis, courses)] if metric == "score" else []
    tables += [mean_table(analysis), driving_table(analysis)]
    if len(analysis.methods) > 1:
        tables += [wins_table(analysis)]
        tables += [matrix_table(analysis, g) for g in analysis.groups] if len(analysis.methods) > 2 else []
        base = (*analysis.baselines, analysis.methods[0])[0]
        found = thirds(analysis, base)
        tables += [thirds_table(analysis, found, base)] if found else []
    tables.append(sets_table(analysis, generation_sets(analysis, courses)))
    if len(analysis.worlds) >= 4:
        tables.append(difficulty_table(analysis, courses))
    return [replace(t, caveats=caveats) for t in tables]


def mean_table(analysis: Analysis) -> Table:
    """Mean traversal time per group and method, success, and improvement over each baseline present."""
    records = tuple(_mean_record(analysis, g, m) for g in analysis.groups for m in analysis.methods)
    columns = [
        *_WORLDS,
        Column("time, s [95 %]", lambda r: _interval(r["mean_time_s"], r["mean_time_low_s"], r["mean_time_high_s"])),
        Column("trials", lambda r: f"{r['trials']:,}"),
        Column("distance, m", lambda r: number(r["distance_m"])),
        Column("success, % [95 %]", _success),
    ]
    for base in analysis.baselines:
        columns.append(Column(f"faster than {base}, s [95 %]", partial(_improvement, base=base)))
    failed, limit = analysis.failed_time_s, analysis.limit_s
    note = (
        f"Protocol {analysis.protocol}: mean over worlds of the mean of trials; a failed trial (limit {limit:g} s) "
        f"counts {failed:g} s. Distance: of the trials that reached the goal."
    )
    return Table("mean", "Mean traversal time", note, tuple(columns), records)


def wins_table(analysis: Analysis) -> Table:
    """Worlds with a significant difference, for every pair of methods; baselines are the opponents."""
    order = sorted(analysis.methods, key=lambda m: m not in analysis.baselines)
    pairs = [(m, other) for j, m in enumerate(order) for other in order[:j]]
    records = tuple(_wins_record(g, m, other) for g in analysis.groups for m, other in pairs)
    columns = (
        *_WORLDS,
        Column("versus", lambda r: str(r["versus"]), left=True),
        Column("better", lambda r: _share(r["better"], r["world_count"])),
        Column("worse", lambda r: _share(r["worse"], r["world_count"])),
        Column("better, FDR", lambda r: _share(r["better_fdr"], r["world_count"])),
        Column("worse, FDR", lambda r: _share(r["worse_fdr"], r["world_count"])),
        Column("P(faster) [95 %]", lambda r: _interval(r["win_probability"], r["win_low"], r["win_high"])),
    )
    note = (
        "Worlds where mean traversal times differ with p < 0.05 (Welch's t-test, each world by itself, as in the "
        "papers), and those left at a false discovery rate of 5 % (Benjamini-Hochberg over worlds). P(faster): chance "
        "that a trial of the method is faster than one of the other in the same world, mean over worlds."
    )
    return Table("wins", "Worlds significantly better or worse", note, columns, records)


def matrix_table(analysis: Analysis, group: Group) -> Table:
    """Per cent of worlds where the row's method is significantly slower than the column's."""
    order = sorted(analysis.methods, key=lambda m: -group.summaries[m].mean_time_s)
    records = []
    for a in order:
        shares = {b: 100.0 * group.comparisons[a, b].worse / len(group.worlds) if a != b else 0.0 for b in order}
        records.append({"worlds": group.name, "method": a, **{f"worse_than_{b}_percent": v for b, v in shares.items()}})
    columns = [Column("method 1 \\ method 2", lambda r: str(r["method"]), left=True)]
    columns += [Column(b, partial(_matrix_cell, other=b)) for b in order]
    note = (
        f"Per cent of the {len(group.worlds)} worlds of {group.name!r} where method 1 is significantly worse than "
        "method 2 in traversal time (p < 0.05, Welch), methods from slowest to fastest; bold: the largest of a row."
    )
    name = "matrix" if len(analysis.groups) == 1 else f"matrix_{group.name}"
    return Table(name, "Pairwise comparison of methods", note, tuple(columns), tuple(records))


def thirds_table(analysis: Analysis, groups: Sequence[Group], base: str) -> Table:
    """Wins and losses against `base` in thirds of its own times."""
    records = tuple(_wins_record(g, m, base) for g in groups for m in analysis.methods if m != base)
    columns = (
        *_WORLDS,
        Column("better", lambda r: _share(r["better"], r["world_count"])),
        Column(f"{base} better", lambda r: _share(r["worse"], r["world_count"])),
        Column("time, s", lambda r: number(r["mean_s"])),
        Column(f"{base}, s", lambda r: number(r["versus_mean_s"])),
        Column("faster, s [95 %]", lambda r: _interval(r["improvement_s"], r["low_s"], r["high_s"])),
    )
    note = (
        f"Thirds of the worlds by {base}'s mean time in the same trials (p < 0.05, Welch). Sorting by the times that "
        f"are then compared makes the others look slightly worse in the easy third and better in the difficult one."
    )
    return Table("thirds", f"Easy, medium and difficult worlds against {base}", note, columns, records)


def sets_table(analysis: Analysis, groups: Sequence[Group]) -> Table:
    """Mean time and success in each of BARN's generation sets."""
    records = tuple(
        {
            "worlds": g.name,
            "world_count": len(g.worlds),
            **{f"{m} {k}": v for m in analysis.methods for k, v in _time_and_success(g, m).items()},
        }
        for g in groups
    )
    columns = [_WORLDS[0]]
    for m in analysis.methods:
        columns.append(Column(f"{m}, s", partial(_keyed, key=f"{m} mean_time_s")))
        columns.append(Column(f"{m}, %", partial(_keyed, key=f"{m} success_percent", digits=1)))
    note = (
        "Mean traversal time (failures counted as in the mean table) and success by fill and smoothing of the worlds."
    )
    return Table("sets", "BARN's generation sets", note, tuple(columns), records)


def difficulty_table(analysis: Analysis, courses: Mapping[int, Course]) -> Table:
    """Rank correlation over worlds of times and improvements with the difficulty metrics."""
    records = tuple(
        {
            "worlds": row.what,
            "metric": row.metric,
            "rho": row.correlation.rho,
            "low": row.correlation.low,
            "high": row.correlation.high,
            "p_value": row.correlation.p_value,
            "q_value": row.q_value,
        }
        for row in difficulty(analysis, courses)
    )
    columns = (
        Column("what", lambda r: str(r["worlds"]), left=True),
        Column("metric", lambda r: str(r["metric"]), left=True),
        Column("ρ [95 %]", lambda r: _interval(r["rho"], r["low"], r["high"])),
        Column("p", lambda r: _p_value(r["p_value"])),
        Column("p, FDR", lambda r: f"*{_p_value(r['q_value'])}*" if r["q_value"] < 0.05 else _p_value(r["q_value"])),
    )
    note = (
        f"Spearman's rank correlation over {len(analysis.worlds)} worlds with the five metrics of Perille et al. 2020; "
        "FDR: adjusted over all rows (Benjamini-Hochberg), bold below 0.05."
    )
    return Table("difficulty", "What makes worlds slow", note, columns, records)


def score_table(analysis: Analysis, courses: Mapping[int, Course]) -> Table:
    """BARN Challenge score under both clips."""
    records = tuple(
        {"method": s.method, "clip": s.clip, "score": s.score, "low": s.low, "high": s.high, "best": s.best}
        for s in challenge_scores(analysis, courses)
    )
    columns = (
        Column("method", lambda r: str(r["method"]), left=True),
        Column("clip", lambda r: str(r["clip"]), left=True),
        Column("score [95 %]", lambda r: _interval(r["score"], r["low"], r["high"], 4)),
        Column("best possible", lambda r: f"{r['best']:.2f}"),
    )
    note = (
        "1[success] OT / clip(time, low OT, 8 OT) with low = 2 since 2024 and 4 before, OT = length of the reference "
        f"way / 2 m/s; mean over {len(analysis.worlds)} worlds of the mean over trials."
    )
    return Table("score", "BARN Challenge score", note, columns, records)


def driving_table(analysis: Analysis) -> Table:
    """Outcomes, collisions, clearance and recoveries."""
    records = tuple(
        {
            "worlds": g.name,
            "world_count": len(g.worlds),
            "method": m,
            "trials": g.summaries[m].trials,
            "distance_m": g.driving[m].distance_m,
            "clearance_m": g.driving[m].clearance_m,
            "collisions": g.driving[m].collisions,
            "recoveries": g.driving[m].recoveries,
            "outcomes": ", ".join(f"{n} {o}" for o, n in g.driving[m].outcomes.items()),
        }
        for g in analysis.groups
        for m in analysis.methods
    )
    columns = (
        *_WORLDS,
        Column("trials", lambda r: f"{r['trials']:,}"),
        Column("collisions a trial", lambda r: number(r["collisions"], 3)),
        Column("least clearance, m", lambda r: number(r["clearance_m"], 3)),
        Column("recoveries a trial", lambda r: number(r["recoveries"])),
        Column("outcomes", lambda r: str(r["outcomes"]), left=True),
    )
    note = "Clearance: median over trials of the least distance between hull and obstacle."
    return Table("driving", "How the robot drove", note, columns, records)


_WORLDS = (
    Column("worlds", lambda r: f"{r['worlds']} ({r['world_count']})", left=True),
    Column("method", lambda r: str(r["method"]), left=True),
)


def _mean_record(analysis: Analysis, group: Group, method: str) -> Record:
    s = group.summaries[method]
    record: Record = {
        "worlds": group.name,
        "world_count": s.worlds,
        "method": method,
        "trials": s.trials,
        "mean_time_s": s.mean_time_s,
        "mean_time_low_s": s.mean_time_low_s,
        "mean_time_high_s": s.mean_time_high_s,
        "distance_m": group.driving[method].distance_m,
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
        "better_fdr": c.better_fdr,
        "worse_fdr": c.worse_fdr,
        "win_probability": c.win_probability,
        "win_low": c.win_low,
        "win_high": c.win_high,
        "mean_s": c.mean_s,
        "versus_mean_s": c.versus_mean_s,
        "improvement_s": c.improvement_s,
        "low_s": c.improvement_low_s,
        "high_s": c.improvement_high_s,
    }


def _time_and_success(group: Group, method: str) -> dict[str, float]:
    s = group.summaries[method]
    return {"mean_time_s": s.mean_time_s, "success_percent": 100.0 * s.success}


def _keyed(record: Record, key: str, digits: int = 2) -> str:
    return number(record[key], digits)


def _matrix_cell(record: Record, other: str) -> str:
    values = [v for k, v in record.items() if k.startswith("worse_than_")]
    value = record[f"worse_than_{other}_percent"]
    return f"*{value:.0f}*" if value > 0.0 and value == max(values) else f"{value:.0f}"


def _success(r: Record) -> str:
    return f"{100 * r['success']:.1f} [{100 * r['success_low']:.1f}, {100 * r['success_high']:.1f}]"


def _improvement(r: Record, base: str) -> str:
    gain_s = r[f"improvement_over_{base}_s"]
    if gain_s is None:
        return ""
    low_s, high_s = r[f"improvement_over_{base}_low_s"], r[f"improvement_over_{base}_high_s"]
    percent = r[f"improvement_over_{base}_percent"]
    return f"{gain_s:.2f} ({percent:.1f} %) [{number(low_s)}, {number(high_s)}]"


def _share(count: int, total: int) -> str:
    return f"{count} ({100.0 * count / total:.1f} %)"


def _interval(value: float, low: float, high: float, digits: int = 2) -> str:
    return f"{number(value, digits)} [{number(low, digits)}, {number(high, digits)}]"


def _p_value(p: float) -> str:
    return "–" if math.isnan(p) else "< 0.001" if p < 0.001 else f"{p:.3f}"


def number(value: float, digits: int = 2) -> str:
    return f"{value:.{digits}f}" if math.isfinite(value) else "–"
