"""An actor that lives sends what dead ones left, under their ids, and nothing else."""

from __future__ import annotations

import os
import subprocess
import sys
import threading
from collections.abc import Iterator
from pathlib import Path

import pytest

from appl_dist.actor.orphans import OrphanSender
from appl_dist.actor.spool import Spool, SpoolInUse
from appl_dist.config import load
from appl_dist.launch.roles import open_spool
from appl_dist.learner.ingest import Ingest
from appl_dist.wire.codec import encode_rollout
from appl_dist.wire.memory import MemoryHub
from appl_dist.wire.upload import UploadServer
from tests.unit.wire.support import ListStore, make_rollout, wait_until


@pytest.fixture
def hub() -> MemoryHub:
    return MemoryHub()


@pytest.fixture
def store(hub: MemoryHub) -> Iterator[ListStore]:
    store = ListStore()
    server = UploadServer(hub.connect(), "run1", Ingest(store, None, "run1"))
    yield store
    server.close()


def leave(root: Path, actor: str, *tags: int, run: str = "run1") -> Path:
    """A spool with rollouts that nobody owns."""
    with Spool(root / actor, f"{run}/{actor}") as spool:
        for tag in tags:
            spool.put(encode_rollout(make_rollout(tag)))
    return root / actor


def waiting(folder: Path) -> int:
    return len(list(folder.glob("*.rollout")))


def test_orphans_are_sent_under_the_ids_of_those_who_made_them(
    hub: MemoryHub, store: ListStore, tmp_path: Path
) -> None:
    a0, a1 = leave(tmp_path, "a0", 1, 2, 3), leave(tmp_path, "a1", 4)
    sender = OrphanSender(hub.connect(), "run1", tmp_path)
    assert sender.sweep() == 4
    assert (store.tags("a0"), store.tags("a1")) == ([1, 2, 3], [4])
    assert (waiting(a0), waiting(a1)) == (0, 0)
    assert sender.sweep() == 0
    leave(tmp_path, "a0", 5)  # the actor is back: its numbers go on
    assert OrphanSender(hub.connect(), "run1", tmp_path).sweep() == 1
    assert store.tags("a0") == [1, 2, 3, 5]


def test_what_a_live_process_owns_is_left_alone(hub: MemoryHub, store: ListStore, tmp_path: Path) -> None:
    leave(tmp_path, "a0", 1)
    with Spool(tmp_path / "a0", "run1/a0"):
        assert OrphanSender(hub.connect(), "run1", tmp_path).sweep() == 0
    assert store.tags("a0") == []


def test_other_runs_ids_beyond_the_credentials_and_other_folders_are_left_alone(
    hub: MemoryHub, store: ListStore, tmp_path: Path
) -> None:
    folders = leave(tmp_path, "a0", 1, run="other"), leave(tmp_path, "b0", 2)
    for name, content in (("junk", b"?"), ("damaged", b'{"owner": 3}')):
        (tmp_path / name).mkdir()
        (tmp_path / name / "000000000000.rollout").write_bytes(b"?")
        (tmp_path / name / "spool.json").write_bytes(content)
    (tmp_path / "file").write_bytes(b"")
    sender = OrphanSender(hub.connect(), "run1", tmp_path, lambda actor_id: actor_id.startswith("a"))
    assert sender.sweep() == 0
    assert [waiting(folder) for folder in folders] == [1, 1]
    assert OrphanSender(hub.connect(), "run1", tmp_path / "none").sweep() == 0


def test_a_refusal_leaves_the_rest_for_later(hub: MemoryHub, tmp_path: Path) -> None:
    folder = leave(tmp_path, "a0", 1)
    server = UploadServer(hub.connect(), "another", Ingest(ListStore(), None, "another"))
    assert OrphanSender(hub.connect(), "run1", tmp_path).sweep() == 0
    assert waiting(folder) == 1
    server.close()


def test_a_sender_that_is_killed_leaves_an_orphan_again(hub: MemoryHub, store: ListStore, tmp_path: Path) -> None:
    leave(tmp_path, "a0", 1, 2)
    code = (
        "import os, sys; from appl_dist.actor.spool import Spool; "
        f"s = Spool({str(tmp_path / 'a0')!r}, 'run1/a0', passing=True); os.kill(os.getpid(), 9)"
    )
    assert subprocess.run([sys.executable, "-c", code], cwd=os.getcwd(), check=False).returncode == -9
    assert OrphanSender(hub.connect(), "run1", tmp_path).sweep() == 2
    assert store.tags("a0") == [1, 2]


def test_an_actor_that_starts_meanwhile_waits_for_its_spool(tmp_path: Path) -> None:
    own = load([f"actor.run={tmp_path}", "actor.id=a0"]).actor
    folder = leave(tmp_path / "spool", "a0", 1)
    opened: list[Spool] = []
    with Spool(folder, "run1/a0", passing=True):
        with pytest.raises(SpoolInUse, match=f"in use by process {os.getpid()};") as refused:
            Spool(folder, "run1/a0")
        assert refused.value.passing
        starting = threading.Thread(target=lambda: opened.append(open_spool(own, own, "run1")))
        starting.start()
        starting.join(0.3)
        assert opened == []
    wait_until(lambda: opened)
    starting.join()
    with opened[0], pytest.raises(SpoolInUse) as refused:
        Spool(folder, "run1/a0")
    assert not refused.value.passing
