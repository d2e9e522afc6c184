"""Files the conformance command cannot use, and what it counts."""

import gzip
import json

import numpy as np
import pytest

from appl_dist.__main__ import main as appl_dist
from appl_dist.planner.vectors import Tally


def written(path, text):
    with gzip.open(path, "wt") as file:
        file.write(text)
    return path


def main(arguments: list[str]) -> int:
    return appl_dist(["conformance", *arguments])


@pytest.mark.parametrize(
    ("name", "text", "says"),
    [
        ("tp.jsonl.gz", "", "not a vector file"),
        ("tp.jsonl.gz", "[1, 2]\n", "not a vector file"),
        ("tp.jsonl.gz", '{"scene": 1', "line 1 is not JSON"),
        ("tp.jsonl.gz", '{"scene": {"lethal": [1]}, "out": {}, "out_cells": {}}\n', "broken"),
        ("dwa.jsonl.gz", '{"scene": {"dwa_params": {}}, "out": {}}\n', "not a supported planner yet"),
        ("other.jsonl.gz", '{"scene": {}}\n', "unknown kind"),
        ("sim.jsonl.gz", '{"episode": {"cyl": [], "id": 1}, "out": {}}\n', "broken"),
    ],
)
def test_unusable_text_is_one_sentence_and_status_2(tmp_path, capsys, name, text, says):
    path = written(tmp_path / name, text)
    assert main([str(path)]) == 2
    error = capsys.readouterr().err
    assert says in error
    assert name in error
    assert error.count("\n") == 1


def test_missing_file_no_file_and_truncated_archives(tmp_path, capsys):
    assert main([]) == 2
    assert main([str(tmp_path / "none.npz")]) == 2
    whole = tmp_path / "inflation.npz"
    np.savez_compressed(whole, lethal=np.zeros(3), costmap=np.zeros(3), inflation_radius=1, inscribed_radius=1)
    assert main([str(whole)]) == 2
    cut = tmp_path / "cut.npz"
    cut.write_bytes(whole.read_bytes()[:-40])
    assert main([str(cut)]) == 2
    pickled = tmp_path / "pickled.npz"
    np.savez(pickled, lethal=np.array([{}], object), costmap=1, inflation_radius=1, inscribed_radius=1)
    assert main([str(pickled)]) == 2
    half = tmp_path / "half.jsonl.gz"
    half.write_bytes(gzip.compress(json.dumps({"scene": 1}).encode())[:-9])
    assert main([str(half)]) == 2
    assert capsys.readouterr().err.count("\n") == 6


def test_a_wrong_cell_is_counted_and_status_1(tmp_path, capsys):
    costmap = np.zeros((1, 200, 200), np.uint8)
    costmap[0, 3, 4] = 7
    path = tmp_path / "inflation.npz"
    np.savez(
        path,
        lethal=np.zeros((1, 200, 25), np.uint8),
        costmap=costmap,
        inflation_radius=np.array([0.3]),
        inscribed_radius=np.array([0.265]),
        cost_scaling_factor=np.array([10.0]),
        resolution=np.float64(0.05),
        origin=np.zeros((1, 2)),
    )
    assert main([str(path)]) == 1
    out = capsys.readouterr().out
    assert "0 of 1 maps equal" in out
    assert "39999 of 40000 cells equal, largest difference 7 cost" in out


def test_tally_counts_rows_and_shapes():
    tally = Tally("rows", "")
    tally.add([[1, 2], [3, 4]], [[1, 2], [3, 5]], items=2, whole=False)
    assert (tally.equal, tally.total, tally.difference) == (1, 2, 1.0)
    tally.add([1.0], [1.0, 2.0], items=2)
    assert (tally.equal, tally.total) == (1, 4)
    assert tally.difference == np.inf
