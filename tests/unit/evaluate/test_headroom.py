"""The search of benchmarks/headroom.py on made-up times: finds the best set, with fresh seeds each stage."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from appl_dist.planner.dwa import DWA
from benchmarks import headroom
from tests.unit.evaluate.synthetic import make_trial

SYNTHETIC = make_trial("", 0, 0, 1.0)
LABELS = [f"set-{i}" for i in range(16)]


class Times:
    """Set i takes 20 + i s in even worlds and 40 - i s in odd ones, give or take a second."""

    def __init__(self) -> None:
        self.asked: list[tuple[str, int, int]] = []

    def __call__(self, wanted: Sequence[tuple[str, int, int]]) -> list[object]:
        self.asked += wanted
        return [self.trial(*w) for w in wanted]

    def trial(self, label: str, world: int, number: int) -> object:
        i = int(label.split("-")[1])
        noise_s = float(np.random.default_rng([world, number, i]).normal())
        time_s = (20 + i if world % 2 == 0 else 40 - i) + noise_s
        return replace(SYNTHETIC, method=label, world=world, trial=number, time_s=time_s)


def test_tuning_once_finds_the_set_that_is_best_on_average() -> None:
    times = Times()
    assert headroom.tune_once(LABELS, list(range(0, 40, 2)), times, 70.0, 4) == "set-0"
    assert headroom.tune_once(LABELS, list(range(1, 40, 2)), times, 70.0, 4) == "set-15"
    assert {k for _, _, k in times.asked} <= set(range(headroom.CHOOSE))


def test_choosing_per_world_finds_each_worlds_best() -> None:
    times = Times()
    chosen = headroom.choose_each(LABELS, [0, 1, 2, 3], times, 70.0, [2, 8])
    assert all(chosen[w] in ("set-0", "set-1") for w in (0, 2))
    assert all(chosen[w] in ("set-15", "set-14") for w in (1, 3))
    assert {k for _, _, k in times.asked} == set(range(headroom.CHOOSE, headroom.CHOOSE + 8))


def test_candidates_are_in_the_box_and_hold_the_baselines() -> None:
    found = headroom.candidates(8, np.random.default_rng(0))
    assert list(found)[:2] == ["default", "fast"]
    assert len(set(found.values())) == 8
    for spec in list(found.values())[2:]:
        values = np.array([float(item.split("=")[1]) for item in spec.removeprefix("set:").split(",")])
        assert np.all((values >= DWA.low) & (values <= DWA.high))


@pytest.mark.slow
def test_every_stage_runs_on_real_episodes(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    options = "--world-count 12 --train 0:4 --test 4:6 --test-count 2 --timings ideal --sets 2 --first-trials 1"
    options += f" --choose-trials 1 --trials 2 --workers 1 --folder {tmp_path}"
    monkeypatch.setattr("sys.argv", ["headroom", *options.split()])
    assert headroom.main() == 0
    rows = json.loads((tmp_path / "headroom.json").read_text())["timings"]["ideal"]
    assert {name: row["trials"] for name, row in rows.items()} == {"default": 4, "fixed": 4, "adapted": 4}
