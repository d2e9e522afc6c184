"""The wire between real processes over zenoh, while they are killed, frozen and restarted."""

from __future__ import annotations

import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from appl_dist.wire.control import ControlServer, fetch_status
from appl_dist.wire.liveness import Roster
from appl_dist.wire.session import open_session
from appl_dist.wire.upload import UploadServer
from appl_dist.wire.wire_settings import WireSettings
from tests.unit.wire.child import LEASE_S
from tests.unit.wire.support import FileStore, ScriptedSink, free_endpoint, wait_until

Child = subprocess.Popen[str]


class Processes:
    """Starts children of one endpoint and folder, and ends those still there."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.endpoint = free_endpoint()
        self._children: list[Child] = []

    def start(self, role: str, *arguments: object) -> Child:
        command = [sys.executable, "-m", "tests.unit.wire.child", role, self.endpoint, str(self.folder)]
        child = subprocess.Popen(
            [*command, *map(str, arguments)], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
        )
        self._children.append(child)
        return child

    def ready(self, child: Child) -> Child:
        assert child.stdout is not None
        assert child.stdout.readline() == "ready\n", child.communicate()[1]
        return child

    def stored(self, actor: str = "a0") -> list[int]:
        """Tags in the order stored; the sequence numbers must count up from 0."""
        rows = [row for row in FileStore.read(self.folder / "stored.txt") if row[0] == actor]
        assert [seq for _, seq, _ in rows] == list(range(len(rows)))
        return [tag for _, _, tag in rows]

    def end(self) -> None:
        for child in self._children:
            child.kill()
            child.communicate()


@pytest.fixture
def processes(tmp_path: Path) -> Iterator[Processes]:
    processes = Processes(tmp_path)
    yield processes
    processes.end()


def kill(child: Child) -> None:
    child.kill()
    child.wait(20)


def test_a_sender_killed_while_uploading_loses_and_repeats_nothing(processes):
    processes.ready(processes.start("receiver", 1))
    count = 400
    for target in (30, 110, 190, 270):
        sender = processes.start("sender", "a0", count)
        arrived = wait_until(lambda: len(processes.stored()) >= target or sender.poll() is not None)  # noqa: B023
        kill(sender)
        assert arrived
        assert len(processes.stored()) >= target, sender.communicate()[1]
    sender = processes.start("sender", "a0", count)
    assert sender.wait(60) == 0, sender.communicate()[1]
    assert processes.stored() == list(range(count))


def test_a_receiver_killed_while_storing_loses_and_repeats_nothing(processes):
    count = 400
    receiver = processes.ready(processes.start("receiver", 1))
    senders = [processes.start("sender", actor, count) for actor in ("a0", "a1")]
    for epoch, target in ((2, 40), (3, 120), (4, 200)):
        assert wait_until(lambda: len(processes.stored("a1")) >= target)  # noqa: B023
        kill(receiver)
        receiver = processes.ready(processes.start("receiver", epoch))
    for sender in senders:
        assert sender.wait(60) == 0, sender.communicate()[1]
    assert processes.stored("a0") == processes.stored("a1") == list(range(count))


@pytest.mark.parametrize("frozen", ["sender", "receiver"])
def test_a_freeze_longer_than_the_lease_loses_and_repeats_nothing(processes, frozen):
    count = 300
    receiver = processes.ready(processes.start("receiver", 1))
    sender = processes.ready(processes.start("sender", "a0", count))
    assert wait_until(lambda: len(processes.stored()) >= 20)
    process = {"sender": sender, "receiver": receiver}[frozen]
    process.send_signal(signal.SIGSTOP)
    time.sleep(2.5 * LEASE_S)  # what is tested is exactly this silence
    process.send_signal(signal.SIGCONT)
    assert sender.wait(60) == 0, sender.communicate()[1]
    assert processes.stored() == list(range(count))


def test_a_second_process_of_the_same_actor_is_refused_and_takes_over_after_a_kill(processes):
    processes.ready(processes.start("receiver", 1))
    first = processes.ready(processes.start("sender", "a0", 10**6))
    (processes.folder / "elsewhere").mkdir()
    stored = processes.folder / "stored.txt"
    (processes.folder / "elsewhere" / "stored.txt").symlink_to(stored)
    home, processes.folder = processes.folder, processes.folder / "elsewhere"
    second = processes.start("sender", "a0", 10)
    assert second.wait(30) == 2
    assert "a0 is in use by another live process of run run1" in second.communicate()[1]
    kill(first)
    done = len(processes.stored())
    # From another machine with an empty spool: it goes on behind what the learner has.
    third = processes.start("sender", "a0", done + 50)
    assert third.wait(30) == 0, third.communicate()[1]
    processes.folder = home
    assert len(processes.stored()) >= done + 50 - 16  # the first one's spool held up to 16


def test_two_processes_cannot_share_a_spool(processes):
    processes.ready(processes.start("receiver", 1))
    processes.ready(processes.start("sender", "a0", 10**6))
    second = processes.start("sender", "a0", 10)
    assert second.wait(30) == 2
    assert "in use by process" in second.communicate()[1]


def test_senders_are_seen_coming_and_going_and_stop_when_told(processes):
    sink = ScriptedSink()
    with open_session(WireSettings(processes.endpoint, lease_s=LEASE_S), listen=True) as session:
        roster = Roster(session, "run1")
        server = UploadServer(session, "run1", sink)
        control = ControlServer(session, "run1", "{}", status=lambda: {"stored": len(sink.seen)})
        senders = [processes.ready(processes.start("sender", actor, 10**6)) for actor in ("a0", "a1")]

        def alive() -> list[str]:
            return [m.member_id for m in roster.members() if m.role == "actor" and m.alive and m.progress]

        assert wait_until(lambda: alive() == ["a0", "a1"])
        kill(senders[0])
        assert wait_until(lambda: alive() == ["a1"])
        assert fetch_status(session, "run1")["stored"] > 0
        control.set_state("stop")
        assert senders[1].wait(40) == 0, senders[1].communicate()[1]
        assert wait_until(lambda: alive() == [])
        late = processes.start("sender", "a2", 10**6)
        assert late.wait(40) == 0, late.communicate()[1]
        for part in (control, server, roster):
            part.close()


def test_a_sender_without_a_learner_says_so(processes):
    sender = processes.start("sender", "a0", 1)
    assert sender.wait(40) == 2
    assert f"no learner answered at {processes.endpoint}" in sender.communicate()[1]
