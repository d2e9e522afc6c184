"""`appl-dist train` with real processes: to its end, through kills and Ctrl-C, resumed, and serially."""

from __future__ import annotations

import json
import os
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import psutil
import pytest

from appl_dist.learner.replay import Replay
from appl_dist.policy_file import PolicyFile
from tests.metrics_file import transitions
from tests.paper_sizes import SIZES

SMALL = [
    "world.count=6",
    "run.transitions=200",
    "learner.min_transitions=60",
    "learner.td3.hidden=[32,32]",
    "learner.replay_capacity=10000",
    "learner.checkpoint_every_s=2",
    "world.train=2:6",
    "evaluation.worlds=0:2",
    "evaluation.trials=2",
    "evaluation.workers=2",
    "evaluation.report=false",
    "actors=2",
]


def free_port() -> int:
    with socket.socket() as s:
        s.bind(("127.0.0.1", 0))
        return int(s.getsockname()[1])


class Run:
    """One `appl-dist train` and its folder."""

    def __init__(self, folder: Path, *overrides: str, resume: bool = False, endpoint: str = "") -> None:
        self.folder = folder
        key = "run.resume" if resume else "run.folder"
        own = [f"wire.endpoint={endpoint or f'tcp/127.0.0.1:{free_port()}'}", f"{key}={folder}"]
        command = [sys.executable, "-m", "appl_dist", "train", *SMALL, *own, *overrides]
        self.process = subprocess.Popen(
            command, cwd=folder.parent, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True
        )

    def children(self, role: str) -> list[psutil.Process]:
        """Living processes of a role; one that was killed has no command line until its parent has waited for it."""
        found = psutil.Process(self.process.pid).children(recursive=True)
        return [p for p in found if role in _command(p)]

    def wait_for(self, what: Callable[[], object], timeout_s: float = 90.0) -> None:
        deadline = time.monotonic() + timeout_s
        while time.monotonic() < deadline and self.process.poll() is None:
            if what():
                return
            time.sleep(0.1)
        pytest.fail(f"train ended or waited too long: {self.finish(1.0)}")

    def finish(self, timeout_s: float = 150.0) -> str:
        try:
            out, _ = self.process.communicate(timeout=timeout_s)
        except subprocess.TimeoutExpired:
            self.process.kill()
            out, _ = self.process.communicate()
            for log in (self.folder / "logs").glob("*.log"):
                out += f"\n--- {log.name}\n{log.read_text()[-2000:]}"
        return out

    def steps(self) -> int:
        """Transitions of the last line of metrics.jsonl."""
        return transitions(self.folder)


def _command(process: psutil.Process) -> list[str]:
    try:
        return list(process.cmdline())
    except psutil.NoSuchProcess:  # gone, or a zombie
        return []


def accounts(folder: Path) -> dict[str, tuple[int, int, int]]:
    """Per actor: rollouts numbered, still in the spool, and in replay."""
    with Replay(folder / "replay", 10_000, 1, 0.99, **SIZES) as replay:
        result = {}
        for spool in sorted((folder / "spool").iterdir()):
            numbered = json.loads((spool / "spool.json").read_text())["next_seq"]
            pending = [int(p.name.split(".")[0]) for p in spool.iterdir() if p.name.split(".")[0].isdigit()]
            result[spool.name] = (
                max([numbered, *(s + 1 for s in pending)]),
                len(pending),
                replay.ring.expected_seq(spool.name),
            )
        return result


@pytest.fixture
def folder(tmp_path: Path) -> Iterator[Path]:
    yield tmp_path / "run"
    mine = [p for p in psutil.process_iter(["cmdline"]) if str(tmp_path) in " ".join(p.info["cmdline"] or [])]
    for p in mine:
        p.kill()
    assert mine == [], "processes were left behind"


def test_a_run_ends_with_a_policy_tables_and_pictures(folder: Path) -> None:
    run = Run(folder, "evaluation.report=true")
    out = run.finish()
    assert run.process.returncode == 0, out
    policy = PolicyFile.load(folder / "policy.safetensors")
    assert policy.transitions >= 200
    assert policy.weights[0].shape == (32, 729)
    assert (folder / "evaluation" / "tables.md").read_text().count("learned") >= 1
    assert (folder / "evaluation" / "figures" / "learning.png").stat().st_size > 5000
    assert len((folder / "evaluation" / "trials.csv").read_text().splitlines()) >= 2 * 2 * 2
    for actor, (numbered, pending, stored) in accounts(folder).items():
        assert stored == numbered - pending, actor


def test_killed_actors_and_learner_come_back_and_nothing_is_lost_or_doubled(folder: Path) -> None:
    run = Run(folder, "run.transitions=500")
    run.wait_for(lambda: run.steps() > 80)
    run.children("actor")[0].kill()
    run.wait_for(lambda: run.steps() > 130)
    run.children("learner")[0].kill()
    before = run.steps()
    run.wait_for(lambda: run.steps() > before + 60)
    out = run.finish()
    assert run.process.returncode == 0, out
    totals = accounts(folder)
    assert len(totals) == 2
    for actor, (numbered, pending, stored) in totals.items():
        assert stored == numbered - pending, (actor, totals)
    assert json.loads((folder / "epoch.json").read_text())["epoch"] == 2


def test_ctrl_c_leaves_a_folder_that_resumes(folder: Path) -> None:
    run = Run(folder, "run.transitions=100000")
    run.wait_for(lambda: run.steps() > 80)
    run.process.send_signal(signal.SIGINT)
    out = run.finish(60.0)
    assert run.process.returncode == 0, out
    assert f"run.resume={folder}" in out
    stopped_at = run.steps()
    again = Run(folder, f"run.transitions={stopped_at + 60}", resume=True)
    out = again.finish()
    assert again.process.returncode == 0, out
    assert again.steps() >= stopped_at + 60
    assert json.loads((folder / "config.json").read_text())["learner"]["td3"]["hidden"] == [32, 32]


def test_killing_the_launcher_leaves_no_process(folder: Path) -> None:
    run = Run(folder, "run.transitions=100000")
    run.wait_for(lambda: run.steps() > 0)
    children = run.children("actor") + run.children("learner")
    assert len(children) == 3
    os.kill(run.process.pid, signal.SIGKILL)
    _, alive = psutil.wait_procs(children, timeout=20.0)
    assert alive == []
    run.process.communicate()


def test_the_whole_graph_runs_in_one_process(folder: Path) -> None:
    run = Run(folder, "serial=true", "run.transitions=120")
    run.wait_for(lambda: run.steps() > 0)
    assert run.children("actor") == []
    out = run.finish()
    assert run.process.returncode == 0, out
    assert PolicyFile.load(folder / "policy.safetensors").transitions >= 120
    [(numbered, pending, stored)] = accounts(folder).values()
    assert stored == numbered - pending
