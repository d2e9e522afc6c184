import errno
import json
import os
import subprocess
import sys
import threading
from pathlib import Path

import pytest

from appl_dist.actor.spool import Spool
from appl_dist.errors import UserError
from appl_dist.wire.receipt import Receipt


def spool_of(folder: str | Path, owner: str, **limits: int) -> Spool:
    """A spool of anything, each blob one transition."""
    return Spool(folder, owner, **limits, receipt=lambda blob: Receipt(1, blob.hex() or "-"))


def names(folder: Path) -> list[str]:
    return sorted(path.name for path in folder.iterdir() if path.name not in ("lock", "spool.json", "produced.log"))


def drain(spool: Spool) -> list[tuple[int, bytes]]:
    got = []
    while (head := spool.peek()) is not None:
        got.append(head)
        spool.ack(head[0])
    return got


def test_first_in_first_out_numbered_from_zero(tmp_path):
    with spool_of(tmp_path, "r/a") as spool:
        assert [spool.put(blob) for blob in (b"x", b"y", b"z")] == [0, 1, 2]
        assert (len(spool), spool.oldest, spool.next_seq, spool.pending_bytes) == (3, 0, 3, 3)
        assert drain(spool) == [(0, b"x"), (1, b"y"), (2, b"z")]
        assert (len(spool), spool.oldest, spool.next_seq) == (0, 3, 3)
        assert names(tmp_path) == []


def test_what_was_not_acked_is_there_after_reopening_and_numbers_go_on(tmp_path):
    with spool_of(tmp_path, "r/a") as spool:
        for blob in (b"x", b"y", b"z"):
            spool.put(blob)
        spool.ack(0)
    with spool_of(tmp_path, "r/a") as spool:
        assert spool.put(b"w") == 3
        assert drain(spool) == [(1, b"y"), (2, b"z"), (3, b"w")]
    with spool_of(tmp_path, "r/a") as spool:
        assert spool.peek() is None
        assert spool.put(b"v") == 4


def test_only_the_oldest_can_be_acked(tmp_path):
    with spool_of(tmp_path, "r/a") as spool:
        spool.put(b"x")
        spool.put(b"y")
        with pytest.raises(ValueError, match="only the oldest"):
            spool.ack(1)


def test_a_full_spool_says_so_after_the_time_out_and_stores_nothing(tmp_path):
    with spool_of(tmp_path, "r/a", max_count=2) as spool:
        spool.put(b"x")
        spool.put(b"y")
        assert spool.put(b"z", timeout_s=0.01) is None
        assert names(tmp_path) == ["000000000000.rollout", "000000000001.rollout"]


def test_a_full_spool_is_said_once_and_an_ending_actor_may_go_beyond_it(tmp_path, caplog):
    with spool_of(tmp_path, "r/a", max_count=1) as spool:
        for blob in (b"x", b"y", b"y"):
            spool.put(blob, timeout_s=0.01)
        assert [record.getMessage().count("is full (1 rollouts") for record in caplog.records] == [1]
        assert spool.put(b"y", beyond=True) == 1
        assert drain(spool) == [(0, b"x"), (1, b"y")]


def test_bytes_are_bounded_too(tmp_path):
    with spool_of(tmp_path, "r/a", max_bytes=10) as spool:
        spool.put(b"123456")
        assert spool.put(b"12345", timeout_s=0.01) is None
        assert spool.put(b"1234", timeout_s=0.01) == 1
        with pytest.raises(ValueError, match="holds up to 10"):
            spool.put(b"x" * 11)


def test_a_blocked_put_goes_on_when_room_is_made(tmp_path):
    with spool_of(tmp_path, "r/a", max_count=1) as spool:
        spool.put(b"x")
        got: list[int | None] = []
        thread = threading.Thread(target=lambda: got.append(spool.put(b"y", timeout_s=20)))
        thread.start()
        spool.ack(0)
        thread.join(20)
        assert got == [1]


@pytest.mark.parametrize("reason", ["", "wire version 2"])
def test_a_blocked_put_is_woken_by_stop(tmp_path, reason):
    with spool_of(tmp_path, "r/a", max_count=1) as spool:
        spool.put(b"x")
        got: list[object] = []

        def put() -> None:
            try:
                got.append(spool.put(b"y", timeout_s=20))
            except UserError as error:
                got.append(str(error))

        thread = threading.Thread(target=put)
        thread.start()
        spool.stop(reason)
        thread.join(20)
        assert got == [reason or None]
    assert names(tmp_path) == ["000000000000.rollout"]


@pytest.mark.parametrize("failing", ["write_bytes", "replace"])
def test_a_full_disk_is_a_sentence_and_leaves_nothing_partial(tmp_path, monkeypatch, failing):
    def no_space(*_: object) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    with spool_of(tmp_path, "r/a") as spool:
        spool.put(b"x")
        with monkeypatch.context() as patch:
            patch.setattr(*((Path, "write_bytes") if failing == "write_bytes" else (os, "replace")), no_space)
            with pytest.raises(UserError, match="No space left on device"):
                spool.put(b"y")
        assert names(tmp_path) == ["000000000000.rollout"]
        assert spool.put(b"z") == 1
        assert drain(spool) == [(0, b"x"), (1, b"z")]


def test_a_folder_that_cannot_be_made_is_a_sentence(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(UserError, match="cannot be written"):
        spool_of(tmp_path / "file" / "spool", "r/a")


def test_two_spools_cannot_share_a_folder(tmp_path):
    with spool_of(tmp_path, "r/a"), pytest.raises(UserError, match=f"in use by process {os.getpid()}"):
        spool_of(tmp_path, "r/a")
    spool_of(tmp_path, "r/a").close()


def test_a_killed_process_leaves_the_folder_free_and_its_rollouts_there(tmp_path):
    code = (
        "import os, signal, sys; from tests.unit.actor.test_spool import spool_of\n"
        "spool = spool_of(sys.argv[1], 'r/a'); spool.put(b'x'); spool.put(b'y'); spool.ack(0)\n"
        "os.kill(os.getpid(), signal.SIGKILL)"
    )
    assert subprocess.run([sys.executable, "-c", code, str(tmp_path)], check=False).returncode == -9
    with spool_of(tmp_path, "r/a") as spool:
        assert drain(spool) == [(1, b"y")]
        assert spool.next_seq == 2


def test_another_owner_is_refused_and_the_folder_released(tmp_path):
    spool_of(tmp_path, "r/a").close()
    with pytest.raises(UserError, match="belongs to r/a, not to r/b"):
        spool_of(tmp_path, "r/b")
    spool_of(tmp_path, "r/a").close()


@pytest.mark.parametrize("text", ["", "[]", "{}", '{"owner": "r/a", "next_seq": "x"}'])
def test_a_damaged_counter_is_a_sentence(tmp_path, text):
    (tmp_path / "spool.json").write_text(text)
    with pytest.raises(UserError, match="damaged"):
        spool_of(tmp_path, "r/a")


def test_torn_and_partial_files_are_dropped(tmp_path):
    with spool_of(tmp_path, "r/a") as spool:
        for blob in (b"first", b"second", b"third"):
            spool.put(blob)
    torn = tmp_path / "000000000001.rollout"
    torn.write_bytes(torn.read_bytes()[:-2])
    (tmp_path / "000000000003.rollout.tmp").write_bytes(b"half")
    with spool_of(tmp_path, "r/a") as spool:
        spool.align(0)
        assert drain(spool) == [(0, b"first"), (1, b"third")]
    assert names(tmp_path) == []


@pytest.mark.parametrize(
    ("expected", "pending"),
    [
        (2, [(2, b"c"), (3, b"d")]),  # as it should be
        (3, [(3, b"d")]),  # 2 was stored, its ack lost
        (4, []),  # all stored
        (0, [(0, b"c"), (1, b"d")]),  # the learner came back with older files
    ],
)
def test_align_meets_the_learner(tmp_path, expected, pending):
    with spool_of(tmp_path, "r/a") as spool:
        for blob in (b"a", b"b", b"c", b"d"):
            spool.put(blob)
        spool.ack(0)
        spool.ack(1)
        spool.align(expected)
        assert spool.next_seq == expected + len(pending)
    with spool_of(tmp_path, "r/a") as spool:
        assert drain(spool) == pending


def test_an_emptied_folder_goes_on_where_the_learner_is(tmp_path):
    with spool_of(tmp_path, "r/a") as spool:
        spool.align(57)
        assert spool.put(b"x") == 57
    assert json.loads((tmp_path / "spool.json").read_text())["next_seq"] == 57


def test_rollouts_the_learner_cannot_have_numbered_are_not_dropped_in_silence(tmp_path):
    with spool_of(tmp_path, "r/a") as spool:
        spool.put(b"x")
        with pytest.raises(UserError, match="another id or empty the folder"):
            spool.align(57)
        assert len(spool) == 1


def test_wait_empty(tmp_path):
    with spool_of(tmp_path, "r/a") as spool:
        assert spool.wait_empty(0.0)
        spool.put(b"x")
        assert not spool.wait_empty(0.01)
