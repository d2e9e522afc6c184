"""The planner against everything recorded from the ROS code; closed loops: every fourth episode."""

import gzip
import json
from itertools import islice

import numpy as np
import pytest

from appl_dist.planner import vector_episodes
from appl_dist.planner.conformance import main
from tests.shared_data import shared


@pytest.mark.parametrize("name", ["tp.jsonl.gz", "tp_grids.npz", "inflation.npz", "navfn.npz"])
def test_everything_is_equal(name, capsys):
    path = shared("reference", name)
    assert main([str(path)]) == 0, capsys.readouterr().out


@pytest.mark.parametrize("first", [0, 20])
def test_closed_loops_are_equal(first):
    path, full = shared("reference", "sim.jsonl.gz"), shared("reference", "sim_full.npz")
    with gzip.open(path, "rt") as lines, np.load(full) as data:
        chosen = (json.loads(line) for line in islice(lines, first, first + 20, 4))
        for tally in vector_episodes.episodes(chosen, data):
            assert tally.equal == tally.total > 0, tally
