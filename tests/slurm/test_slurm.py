"""A run on a real Slurm of three nodes, two of which fail: nothing is lost, nothing doubled, nothing left behind.

Slow and not of this package's own making, so it runs when asked for: APPL_TEST_SLURM=1 python -m pytest tests/slurm
"""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from appl_dist.launch.ledger import run_ledger
from tests.metrics_file import transitions
from tests.slurm.cluster import Cluster, missing_programs

ROOT = Path(__file__).resolve().parents[2]
WAIT_S = 180.0


@pytest.fixture
def cluster(tmp_path: Path) -> Iterator[Cluster]:
    if os.environ.get("APPL_TEST_SLURM") != "1":
        pytest.skip("takes minutes: set APPL_TEST_SLURM=1 to run it")
    if missing := missing_programs():
        pytest.skip(f"no Slurm on this machine (apt install slurm-wlm munge): {', '.join(missing)} not found")
    cluster = Cluster(tmp_path / "slurm", 3)
    yield cluster
    cluster.close()


class Run:
    """A run launched on a cluster."""

    def __init__(self, cluster: Cluster, folder: Path, *overrides: str) -> None:
        self.cluster, self.folder = cluster, folder
        out = self.appl_dist(
            "launch", "launch=slurm", "launch.actors=3", "launch.actors_per_task=2", "launch.learner_cpus=2",
            "launch.signal_s=30", "launch.time=30", f"run.folder={folder}", "world.count=6",
            "run.transitions=1000000", "learner.min_transitions=60", "learner.td3.hidden=[32,32]",
            "learner.replay_capacity=100000", "learner.checkpoint_every_s=3", *overrides,
        )  # fmt: skip
        words = out.replace(";", " ").replace(",", " ").split()
        self.learner, self.actors = (words[i + 1] for i, word in enumerate(words) if word == "job")

    def appl_dist(self, *arguments: str) -> str:
        done = subprocess.run(
            [sys.executable, "-m", "appl_dist", *arguments],
            cwd=ROOT, env=self.cluster.environment, capture_output=True, text=True, timeout=120, check=False,
        )  # fmt: skip
        assert done.returncode == 0, done.stderr
        return done.stdout

    def transitions(self) -> int:
        return transitions(self.folder)

    def grow(self, more: int) -> None:
        target = self.transitions() + more
        self.wait(lambda: self.transitions() >= target, f"{target} transitions")

    def wait(self, what: Callable[[], object], name: str) -> None:
        deadline = time.monotonic() + WAIT_S
        while time.monotonic() < deadline:
            if what():
                return
            time.sleep(0.5)
        logs = "".join(f"\n--- {f.name}\n{f.read_text()[-1500:]}" for f in sorted((self.folder / "logs").glob("*.log")))
        queue = self.cluster.run("squeue")
        pytest.fail(f"waited too long for {name}; queue:\n{queue}\nnodes: {self.cluster.states()}{logs}")


def test_a_run_outlives_its_nodes_and_ends_everywhere_when_it_is_stopped(cluster: Cluster, tmp_path: Path) -> None:
    run = Run(cluster, tmp_path / "shared" / "run")
    run.grow(100)
    assert "actor-1-0" in run.appl_dist("status", f"actor.run={run.folder}")

    # The daemon of an actor's node dies. Slurm starts the task anew elsewhere, while the old actor is still at work.
    task = f"{run.actors}_1"
    before = cluster.node_of(task)
    assert before and before != cluster.node_of(run.learner)
    cluster.kill_daemon(before)
    run.wait(lambda: cluster.node_of(task) not in ("", before), "the task to run elsewhere")
    run.grow(100)

    # The learner's node fails with all that runs on it.
    node = cluster.node_of(run.learner)
    assert len(cluster.kill_node(node)) >= 2
    run.wait(lambda: "DOWN" in cluster.states()[node], "the node to count as down")
    cluster.start_node(node)
    run.wait(lambda: cluster.node_of(run.learner), "the learner to run again")
    run.wait(lambda: (run.folder / "logs" / "learner.log").read_text().count("TD3 on") >= 2, "the second learner")
    run.grow(100)
    assert json.loads((run.folder / "epoch.json").read_text())["epoch"] >= 2

    cluster.run("scancel", run.learner, run.actors)
    run.wait(lambda: cluster.run("squeue", "--noheader") == "", "all jobs to end")
    run.wait(lambda: cluster.processes() == [], "all processes to end, on the failed node too")
    ledger = run_ledger(run.folder)
    assert ledger.agrees, ledger.sentence()
    assert len(ledger.accounts) == 3
    assert ledger.total().stored >= 300
    print(ledger.sentence())


def test_the_time_limit_comes_after_a_checkpoint_and_the_run_goes_on(cluster: Cluster, tmp_path: Path) -> None:
    run = Run(cluster, tmp_path / "shared" / "run")
    run.grow(80)
    cluster.run("scancel", "--batch", "--signal=USR1", run.learner)  # what Slurm sends before the limit
    run.wait(lambda: "left at" in (run.folder / "logs" / "learner.log").read_text(), "the learner to leave")
    log = run.folder / "logs" / "learner.log"
    run.wait(lambda: "resumed at" in log.read_text(), "the learner to resume")
    run.grow(80)
    cluster.run("scancel", run.learner, run.actors)
    run.wait(lambda: cluster.run("squeue", "--noheader") == "", "all jobs to end")
    ledger = run_ledger(run.folder)
    assert ledger.agrees, ledger.sentence()
    left, resumed = (
        re.findall(rf"{word} (\d+) transitions, (\d+) updates", log.read_text())[0]
        for word in ("left at", "resumed at")
    )
    assert left[1] == resumed[1]
    assert int(left[0]) <= int(resumed[0])  # uploads are stored until the process ends
