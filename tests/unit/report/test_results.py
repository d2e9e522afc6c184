"""Analysis, tables, figures and summary of trials whose numbers are known."""

from __future__ import annotations

import csv
import io
import json
import math
from pathlib import Path

import numpy as np
import pytest
from rich.console import Console

from appl_dist.errors import UserError
from appl_dist.evaluate.analysis import Analysis, analyse, as_dict
from appl_dist.files import write_atomic
from appl_dist.report import figures, style
from appl_dist.report.tables import mean_table, wins_table
from tests.unit.evaluate.synthetic import make_trial

GROUPS = {"train": [0, 1, 2], "test": [3]}
# Mean times in worlds 0..3; trials lie 0.1 s around them, so every difference of a second is significant.
TIMES_S = {"default": (20.0, 30.0, 40.0, 50.0), "fixed": (20.0, 25.0, 40.0, 45.0), "applr": (15.0, 20.0, 41.0, 30.0)}


@pytest.fixture
def analysis() -> Analysis:
    offsets_s = (-0.1, 0.0, 0.1)
    trials = [
        make_trial(m, w, k, t + dt)
        for m, ts in TIMES_S.items()
        for w, t in enumerate(ts)
        for k, dt in enumerate(offsets_s)
    ]
    return analyse(trials, list(TIMES_S), GROUPS, limit_s=60.0, failed_time_s=70.0)


def test_mean_table_holds_table_five(analysis: Analysis) -> None:
    rows = {(r["worlds"], r["method"]): r for r in mean_table(analysis).records}
    applr = rows["train", "applr"]
    assert applr["mean_time_s"] == pytest.approx(76.0 / 3)
    assert applr["improvement_over_default_s"] == pytest.approx(14.0 / 3)
    assert applr["improvement_over_default_percent"] == pytest.approx(100 * 14.0 / 90)
    assert applr["improvement_over_fixed_s"] == pytest.approx(9.0 / 3)
    assert rows["train", "default"]["improvement_over_default_s"] is None
    assert rows["test", "applr"]["mean_time_s"] == pytest.approx(30.0)
    assert rows["test", "applr"]["world_count"] == 1


def test_wins_table_holds_table_six(analysis: Analysis) -> None:
    rows = {(r["worlds"], r["method"], r["versus"]): (r["better"], r["worse"]) for r in wins_table(analysis).records}
    assert rows["train", "applr", "default"] == (2, 1)
    assert rows["train", "applr", "fixed"] == (2, 1)
    assert rows["train", "fixed", "default"] == (1, 0)
    assert rows["test", "applr", "default"] == (1, 0)
    assert len(rows) == 6


def test_both_baselines_are_opponents_wherever_they_are_listed() -> None:
    trials = [make_trial(m, 0, k, 20.0 + k) for m in ("mine", "fixed", "default") for k in range(2)]
    found = analyse(trials, ["mine", "fixed", "default"], {"all": [0]}, limit_s=50.0, failed_time_s=70.0)
    pairs = [(r["method"], r["versus"]) for r in wins_table(found).records]
    assert ("mine", "default") in pairs
    assert ("mine", "fixed") in pairs
    assert len(pairs) == 3


def test_tables_read_the_same_in_every_form(analysis: Analysis) -> None:
    for table in (mean_table(analysis), wins_table(analysis)):
        rows = list(csv.DictReader(io.StringIO(table.csv())))
        assert [r["worlds"] for r in rows] == [r["worlds"] for r in table.records]
        assert list(rows[0]) == list(table.records[0])
        lines = table.markdown().splitlines()
        assert sum(line.startswith("|") for line in lines) == len(rows) + 2
        assert len({line.count("|") for line in lines if line.startswith("|")}) == 1
        console = Console(record=True, width=160, file=io.StringIO())
        console.print(table.rich())
        assert table.note in " ".join(console.export_text().split())
    assert "2 (66.7 %)" in wins_table(analysis).markdown()
    assert "4.67 (15.6 %)" in mean_table(analysis).markdown()


def test_only_worlds_all_methods_have_driven_are_compared() -> None:
    trials = [make_trial("default", w, k, 20.0 + w) for w in range(3) for k in range(2)]
    trials += [make_trial("applr", w, k, 10.0) for w in (1,) for k in range(2)]
    found = analyse(trials, ["default", "applr"], {"all": [0, 1, 2], "none": [0]}, limit_s=50.0, failed_time_s=70.0)
    assert [g.worlds for g in found.groups] == [(1,)]
    assert found.groups[0].summaries["default"].mean_time_s == 21.0


def test_summary_is_json_without_nan(analysis: Analysis) -> None:
    text = json.dumps(as_dict(analysis), allow_nan=False)  # the interval over one test world is not defined
    plain = json.loads(text)
    assert plain["groups"]["test"]["comparisons"][0]["improvement_low_s"] is None
    assert plain["groups"]["train"]["methods"]["default"]["mean_time_s"] == pytest.approx(30.0)
    assert plain["groups"]["train"]["methods"]["applr"]["outcomes"] == {"goal": 9}


def test_figures_are_written_and_repeat_byte_for_byte(analysis: Analysis, tmp_path: Path) -> None:
    files = style.save_figure(figures.difference_figure(analysis, "applr", "default"), tmp_path / "difference")
    again = style.save_figure(figures.difference_figure(analysis, "applr", "default"), tmp_path / "again")
    assert [f.read_bytes() for f in files] == [f.read_bytes() for f in again]
    assert files[0].read_bytes().startswith(b"\x89PNG")
    assert files[1].read_bytes().startswith(b"%PDF")
    assert not list(tmp_path.glob("*.tmp"))


def test_difference_bars_show_each_world_once_with_its_colour(analysis: Analysis) -> None:
    panel = figures.difference_figure(analysis, "applr", "default").axes[0]
    bars = {
        c.get_label(): [[round(p.get_x() + 0.45, 6), round(p.get_height(), 6)] for p in c]
        for c in panel.containers
        if len(c)
    }
    assert bars == {
        "applr significantly faster: 2": [[1.0, -10.0], [2.0, -5.0]],
        "applr significantly slower: 1": [[3.0, 1.0]],
    }


def test_ecdf_ends_at_the_success_rate() -> None:
    trials = [make_trial("a", 0, k, 10.0 + k) for k in range(3)] + [make_trial("a", 0, 3, 50.0, success=False)]
    found = analyse(trials, ["a"], {"all": [0]}, limit_s=50.0, failed_time_s=70.0)
    x, y = figures.ecdf_figure(found).axes[0].lines[0].get_data()
    assert np.asarray(x).tolist() == [0.0, 10.0, 11.0, 12.0, 50.0]
    assert np.asarray(y).tolist() == [0.0, 0.25, 0.5, 0.75, 0.75]


def test_learning_curve_shows_the_learners_means_and_the_baselines(tmp_path: Path) -> None:
    file = tmp_path / "metrics.jsonl"
    rows = [{"step": 10 * i, "episode/time_s": 30.0 - i, "episode/success": 0.1 * i} for i in range(1, 4)]
    lines = [json.dumps(r) for r in rows] + [
        '{"loss": 1}',
        '{"step": 70, "episode/time_s": null, "episode/success": null}',
        '{"tra',
    ]
    file.write_text("\n".join(lines))
    transitions, time_s, success = figures.read_metrics(file)
    assert transitions.tolist() == [10, 20, 30]
    assert time_s.tolist() == [29, 28, 27]
    figure = figures.learning_figure(transitions, time_s, success, {"default": (30.0, 0.9)})
    assert [np.asarray(line.get_ydata()).tolist() for line in figure.axes[0].lines] == [[29, 28, 27], [30.0, 30.0]]
    assert figure.axes[1].lines[1].get_ydata()[0] == 0.9


def test_metrics_that_cannot_be_read_are_named(tmp_path: Path) -> None:
    with pytest.raises(UserError, match=r"none\.jsonl: No such file"):
        figures.read_metrics(tmp_path / "none.jsonl")
    (tmp_path / "empty.jsonl").write_text("{}\n")
    with pytest.raises(UserError, match="nothing to draw"):
        figures.read_metrics(tmp_path / "empty.jsonl")


def test_a_file_that_cannot_be_written_keeps_the_old_one(tmp_path: Path) -> None:
    (tmp_path / "taken").mkdir()
    with pytest.raises(UserError, match=r"taken: cannot be written"):
        write_atomic(tmp_path / "taken", "x")
    assert [p.name for p in tmp_path.iterdir()] == ["taken"]
    write_atomic(tmp_path / "new" / "file", "x")
    assert (tmp_path / "new" / "file").read_text() == "x"


def test_a_method_that_always_fails_is_no_exception() -> None:
    trials = [make_trial("default", w, k, 50.0, success=False) for w in range(3) for k in range(4)]
    trials += [make_trial("applr", w, k, 20.0 + k) for w in range(3) for k in range(4)]
    found = analyse(trials, ["default", "applr"], {"all": [0, 1, 2]}, limit_s=50.0, failed_time_s=70.0)
    c = found.groups[0].comparisons["applr", "default"]
    assert (c.better, c.worse, c.improvement_s) == (3, 0, 48.5)
    assert not math.isnan(c.improvement_low_s)
    figures.ecdf_figure(found)
