"""An evaluation whose trials are driven by actors elsewhere, one of which is killed: the same trials, each once."""

from __future__ import annotations

import csv
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from appl_dist.planner.dwa import DWA
from appl_dist.policy_file import PolicyFile
from tests.integration.test_train import free_port
from tests.paper_sizes import LAYOUT, OBSERVATION_SIZE

EVALUATION = ("world.count=6", "evaluation.worlds=0:3", "evaluation.trials=2", "evaluation.workers=1")


def start(*arguments: str, folder: Path, log: str) -> subprocess.Popen[bytes]:
    with (folder / log).open("wb") as out:
        return subprocess.Popen([sys.executable, "-m", "appl_dist", *arguments], cwd=folder, stdout=out, stderr=out)


def rows(file: Path) -> list[dict[str, str]]:
    lines = [line for line in file.read_text().splitlines() if not line.startswith("#")] if file.exists() else []
    return list(csv.DictReader(lines))


def wait_for(what: Callable[[], bool], folder: Path, timeout_s: float = 400.0) -> None:
    deadline = time.monotonic() + timeout_s
    while not what():
        if time.monotonic() > deadline:
            pytest.fail("".join(f"\n--- {f.name}\n{f.read_text()[-2000:]}" for f in sorted(folder.glob("*.log"))))
        time.sleep(0.2)


@pytest.mark.slow
@pytest.mark.timeout(900)
def test_actors_elsewhere_drive_the_same_trials_each_once_though_one_is_killed(tmp_path: Path, policy: Path) -> None:
    methods = f"+evaluation.methods.mine={policy}"
    here = start("evaluate", *EVALUATION, methods, "evaluation.folder=here", folder=tmp_path, log="here.log")
    endpoint = f"wire.endpoint=tcp/127.0.0.1:{free_port()}"
    spread = ("evaluation.spread=true", "evaluation.folder=spread")
    evaluator = start("evaluate", *EVALUATION, methods, *spread, endpoint, folder=tmp_path, log="spread.log")
    actors = [
        start("actor", endpoint, "wire.timeout_s=60", f"actor.id=actor-{i}", folder=tmp_path, log=f"{i}.log")
        for i in range(2)
    ]
    try:
        wait_for(lambda: len(rows(tmp_path / "spread" / "trials.csv")) >= 3, tmp_path)
        actors[0].kill()
        wait_for(lambda: all(len(rows(tmp_path / f / "trials.csv")) >= 12 for f in ("here", "spread")), tmp_path)
        assert actors[1].wait(120) == 0, (tmp_path / "1.log").read_text()
    finally:
        for process in (here, evaluator, *actors):
            process.kill()
            process.wait()
    ours, theirs = (sorted(rows(tmp_path / f / "trials.csv"), key=str) for f in ("here", "spread"))
    assert len(theirs) == 2 * 3 * 2  # methods, worlds, trials
    assert ours == theirs  # every field, the digest of the trajectory among them


@pytest.fixture
def policy(tmp_path: Path) -> Path:
    rng = np.random.default_rng(0)
    shapes = ((16, OBSERVATION_SIZE), (len(DWA), 16))
    weights = [rng.normal(0.0, m**-0.5, (n, m)).astype(np.float32) for n, m in shapes]
    biases = [np.zeros(n, np.float32) for n, _ in shapes]
    file = PolicyFile(weights, biases, space=DWA, observation=LAYOUT, epoch=1, version=1, transitions=0)
    path = tmp_path / "mine.safetensors"
    file.save(path)
    return path
