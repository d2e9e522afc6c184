"""Learner and actors started apart, as on several machines: they find each other, move, join, leave, end together."""

from __future__ import annotations

import json
import re
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import psutil
import pytest

from appl_dist.errors import USER_ERROR, PassingFault
from appl_dist.launch.ledger import run_ledger
from appl_dist.launch.runs import whereabouts, with_keys_of
from appl_dist.wire.control import fetch_run, fetch_run_status
from appl_dist.wire.credentials import VIEWER
from appl_dist.wire.session import open_session
from appl_dist.wire.wire_settings import WireSettings
from tests.integration.test_train import free_port
from tests.metrics_file import transitions

SMALL = (
    "world.count=6", "run.transitions=1000000", "learner.min_transitions=60", "learner.td3.hidden=[32,32]",
    "learner.replay_capacity=100000", "learner.checkpoint_every_s=3",
)  # fmt: skip


class Fleet:
    """Processes of one run, each with its own log."""

    def __init__(self, folder: Path) -> None:
        self.run = folder / "run"
        self._folder = folder
        self._started: list[subprocess.Popen[bytes]] = []

    def start(self, *arguments: str) -> subprocess.Popen[bytes]:
        log = self._folder / f"{len(self._started)}.log"
        with log.open("wb") as out:
            process = subprocess.Popen(
                [sys.executable, "-m", "appl_dist", *arguments], cwd=self._folder, stdout=out, stderr=out
            )
        self._started.append(process)
        return process

    def learner(self) -> subprocess.Popen[bytes]:
        """On every interface, so that the run makes and uses keys of its own."""
        return self.start("learner", *SMALL, f"run.folder={self.run}", f"wire.endpoint=tcp/0.0.0.0:{free_port()}")

    def log(self, process: subprocess.Popen[bytes]) -> str:
        return (self._folder / f"{self._started.index(process)}.log").read_text()

    def status(self, *arguments: str) -> tuple[int, str]:
        command = [sys.executable, "-m", "appl_dist", "status", f"actor.run={self.run}", *arguments]
        done = subprocess.run(command, capture_output=True, text=True, timeout=180, check=False)
        return done.returncode, done.stdout + done.stderr

    def names(self) -> list[str]:
        """Actors that the learner lists as heard of."""
        endpoint = whereabouts(self.run).endpoint
        wire = with_keys_of(str(self.run), WireSettings(endpoint, timeout_s=30.0))
        with open_session(wire, listen=False, identity=VIEWER) as session:
            run_id, _ = fetch_run(session, 30.0)
            return [a.id for a in fetch_run_status(session, run_id, 30.0).actors if a.silent_s < 60.0]

    def transitions(self) -> int:
        return transitions(self.run)

    def grow(self, more: int) -> None:
        target = self.transitions() + more
        self.wait(lambda: self.transitions() >= target, f"{target} transitions")

    def wait(self, what: Callable[[], object], name: str, timeout_s: float = 300.0) -> None:
        deadline = time.monotonic() + timeout_s
        while time.monotonic() < deadline:
            if what():
                return
            time.sleep(0.5)
        logs = "".join(f"\n--- {f.name}\n{f.read_text()[-1500:]}" for f in sorted(self._folder.rglob("*.log")))
        pytest.fail(f"waited too long for {name}{logs}")

    def end(self) -> None:
        """Kill what was started here; what it started itself must then end by itself."""
        below = [p for process in self._started if process.poll() is None for p in _below(process.pid)]
        for process in self._started:
            process.kill()
            process.wait()
        psutil.wait_procs(below, timeout=60.0)


def _below(pid: int) -> list[psutil.Process]:
    return psutil.Process(pid).children(recursive=True)


@pytest.fixture
def fleet(tmp_path: Path) -> Iterator[Fleet]:
    fleet = Fleet(tmp_path)
    yield fleet
    fleet.end()
    mine = [p for p in psutil.process_iter(["cmdline"]) if str(tmp_path) in " ".join(p.info["cmdline"] or [])]
    for p in mine:
        p.kill()
    assert mine == [], "processes were left behind"


@pytest.mark.slow
@pytest.mark.timeout(900)
def test_actors_follow_a_learner_that_moves_join_leave_and_end_with_the_run(fleet: Fleet) -> None:
    far = fleet.start(
        "actors", "actors=2", f"actor.run={fleet.run}", "actor.id=actor-far"
    )  # before there is any learner
    first = fleet.learner()
    fleet.grow(80)
    fleet.wait(lambda: fleet.names() == ["actor-far-0", "actor-far-1"], "both to be listed")
    assert fleet.status("--here")[0] == 0
    with pytest.raises(PassingFault, match="refused the credentials"):
        open_session(WireSettings(whereabouts(fleet.run).endpoint, timeout_s=2.0), listen=False)

    first.send_signal(signal.SIGTERM)  # a node is taken away: only this process ends
    assert first.wait(180) == 0, fleet.log(first)
    assert far.poll() is None
    code, words = fleet.status()
    assert code == 2
    assert "no learner" in words
    second = fleet.learner()  # on another port
    fleet.wait(lambda: "resumed at" in fleet.log(second), "the learner to resume")
    left, resumed = (
        re.findall(rf"{word} (\d+) transitions, (\d+) updates", text)[0]
        for text, word in ((fleet.log(first), "left at"), (fleet.log(second), "resumed at"))
    )
    assert left[1] == resumed[1]
    assert int(left[0]) <= int(resumed[0])  # uploads are stored until the process ends
    fleet.grow(80)
    assert json.loads((fleet.run / "epoch.json").read_text())["epoch"] == 2

    victim = next(p for p in psutil.Process(far.pid).children() if any("far-0" in a for a in p.cmdline()))
    victim.kill()
    joined = fleet.start("actor", f"actor.run={fleet.run}")
    other = fleet.start("actor", f"actor.run={fleet.run}")
    everyone = ["actor-0", "actor-1", "actor-far-0", "actor-far-1"]
    fleet.wait(lambda: fleet.names() == everyone, "two to join, one to return")
    assert "far-0 died with status -9" in fleet.log(far)
    joined.send_signal(signal.SIGTERM)
    assert joined.wait(180) == 0, fleet.log(joined)
    fleet.wait(lambda: len(fleet.names()) == 3, "one to leave")

    second.send_signal(signal.SIGINT)
    assert second.wait(180) == 0, fleet.log(second)
    assert far.wait(180) == 0, fleet.log(far)
    assert other.wait(180) == 0, fleet.log(other)
    ledger = run_ledger(fleet.run)
    assert ledger.agrees, ledger.sentence()
    assert sorted(ledger.accounts) == everyone
    late = fleet.start("actors", "actors=2", f"actor.run={fleet.run}", "actor.id=late")
    assert late.wait(180) == 0
    assert "the run has ended" in fleet.log(late)


def test_killing_the_keeper_of_actors_leaves_none(fleet: Fleet) -> None:
    fleet.learner()
    far = fleet.start("actors", "actors=2", f"actor.run={fleet.run}", "actor.id=actor-far")
    fleet.wait(lambda: fleet.transitions() > 0, "a first rollout")
    children = psutil.Process(far.pid).children(recursive=True)
    assert len(children) == 2
    far.kill()
    _, alive = psutil.wait_procs(children, timeout=20.0)
    assert alive == []


def test_a_fleet_whose_actors_die_of_one_cause_ends_with_it(fleet: Fleet) -> None:
    fleet.learner()
    (fleet.run.parent / "file").write_bytes(b"")
    far = fleet.start(
        "actors", "actors=2", f"actor.run={fleet.run}", "actor.id=actor-far", f"actor.spool={fleet.run.parent}/file"
    )
    assert far.wait(300) == USER_ERROR, fleet.log(far)
    last = fleet.log(far).strip().splitlines()[-1]
    assert re.search(r"actor-far-[01] ended 3 times in the same way, with status 2: .*spool .*cannot be written", last)
