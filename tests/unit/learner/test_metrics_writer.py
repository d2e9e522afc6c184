from __future__ import annotations

import json
import math
from pathlib import Path

import pytest
from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

from appl_dist.errors import UserError
from appl_dist.learner.metrics_writer import METRICS_FILE, MetricsWriter


def test_both_files_hold_what_was_written(tmp_path: Path) -> None:
    with MetricsWriter(tmp_path, clock=lambda: 12.5) as writer:
        writer.write(100, {"loss/critic": 0.5, "time_s": 30.0})
        writer.write(200, {"loss/critic": math.nan})
    records = [json.loads(line) for line in (tmp_path / METRICS_FILE).read_text().splitlines()]
    assert records == [
        {"unix_s": 12.5, "step": 100, "loss/critic": 0.5, "time_s": 30.0},
        {"unix_s": 12.5, "step": 200, "loss/critic": None},
    ]
    events = EventAccumulator(str(tmp_path)).Reload()
    first = events.Scalars("loss/critic")[0]
    assert (first.step, first.value) == (100, 0.5)


def test_it_goes_on_after_a_kill_in_the_middle_of_a_line(tmp_path: Path) -> None:
    with MetricsWriter(tmp_path) as writer:
        writer.write(1, {"a": 1.0})
    with open(tmp_path / METRICS_FILE, "a") as file:
        file.write('{"unix_s": 1, "st')
    with MetricsWriter(tmp_path) as writer:
        writer.write(2, {"a": 2.0})
    records = [json.loads(line) for line in (tmp_path / METRICS_FILE).read_text().splitlines()]
    assert [r["step"] for r in records] == [1, 2]


def test_a_folder_that_cannot_be_written_is_named(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(UserError, match="cannot be written"):
        MetricsWriter(tmp_path / "file")
