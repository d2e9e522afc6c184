"""A small evaluation from policies and worlds to files, in the real environment."""

from __future__ import annotations

import io
import json
from pathlib import Path

import pytest
from rich.console import Console

from appl_dist.errors import UserError
from appl_dist.evaluate.main import evaluate
from appl_dist.sim.generate import generate_worlds

METHODS = [("default", "default"), ("fixed", "set:max_vel_x=1,vx_samples=10"), ("mine", "appli:A2")]


def quiet() -> Console:
    return Console(file=io.StringIO(), record=True, width=150)


def test_evaluation_writes_tables_figures_and_goes_on(tmp_path: Path) -> None:
    worlds = generate_worlds(2, seed=0)
    console = quiet()
    found = evaluate(METHODS, worlds, 1, tmp_path, workers=2, seed=3, console=console)
    assert len(found.trials) == 6
    assert all(0.0 < t.time_s <= 50.1 for t in found.trials)
    assert "Mean traversal time" in console.export_text()
    names = {str(p.relative_to(tmp_path)) for p in tmp_path.rglob("*") if p.is_file()}
    assert {
        "trials.csv",
        "summary.json",
        "table_mean.md",
        "table_mean.csv",
        "table_wins.md",
        "table_wins.csv",
        "figures/times.pdf",
        "figures/difference_mine_default.png",
        "figures/difference_mine_fixed.png",
        "figures/difference_fixed_default.png",
    } <= names
    summary = json.loads((tmp_path / "summary.json").read_text())
    assert summary["protocol"]["failed_time_s"] == 70.0
    assert [m["label"] for m in summary["methods"]] == ["default", "fixed", "mine"]
    written = (tmp_path / "trials.csv").read_bytes()
    more = evaluate(METHODS, worlds, 1, tmp_path, workers=0, seed=3, console=quiet())
    assert more.trials == found.trials
    assert (tmp_path / "trials.csv").read_bytes() == written
    with pytest.raises(UserError, match="other settings"):
        evaluate(METHODS, worlds, 1, tmp_path, workers=0, seed=4, console=quiet())
    serial = evaluate(METHODS, worlds, 1, tmp_path / "serial", workers=0, seed=3, console=quiet())
    assert serial.trials == found.trials


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"methods": [("mine", "nowhere.policy")]}, "nowhere.policy"),
        ({"methods": []}, "methods: got none"),
        ({"methods": [("a", "default"), ("a", "default")]}, "used twice"),
        ({"groups": {"test": [0, 99]}}, "world 99"),
        ({"worlds": []}, "worlds: got none"),
        ({"protocol": "fast"}, "protocol: got 'fast'"),
        ({"trials_per_world": 0}, "trials: got 0"),
        ({"workers": -1}, "workers: got -1"),
    ],
)
def test_bad_input_is_one_sentence_before_any_trial(tmp_path: Path, change: dict[str, object], words: str) -> None:
    arguments: dict[str, object] = {
        "methods": METHODS[:1],
        "worlds": generate_worlds(2, seed=0),
        "trials_per_world": 1,
        "folder": tmp_path / "out",
        "console": quiet(),
    }
    with pytest.raises(UserError, match=words):
        evaluate(**(arguments | change))  # type: ignore[arg-type]
    assert not (tmp_path / "out" / "summary.json").exists()
