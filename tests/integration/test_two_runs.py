"""Two whole runs on one endpoint, started at once: each has exactly its own rollouts, or is refused by name."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from appl_dist.errors import USER_ERROR
from appl_dist.launch.ledger import run_ledger
from tests.integration.test_train import Run, free_port


@pytest.mark.slow
@pytest.mark.timeout(600)
def test_two_runs_on_one_endpoint_never_mix(tmp_path: Path) -> None:
    endpoint = f"tcp/127.0.0.1:{free_port()}"  # the default port may be anyone's
    runs = [Run(tmp_path / name, endpoint=endpoint) for name in ("first", "second")]
    said = [run.finish(300.0) for run in runs]
    statuses = [run.process.returncode for run in runs]
    ids = [json.loads((run.folder / "config.json").read_text())["run"]["id"] for run in runs]

    assert 0 in statuses, said
    for run, out, status, other in zip(runs, said, statuses, reversed(ids), strict=True):
        if status == 0:
            ledger = run_ledger(run.folder)
            assert ledger.agrees, ledger.sentence()
            assert ledger.replay_total >= 200
        else:
            assert status == USER_ERROR, out
            assert f"run {other}" in out.strip().splitlines()[-1], out
            assert not list((run.folder / "spool").rglob("*.rollout")), "it collected for the other run"
