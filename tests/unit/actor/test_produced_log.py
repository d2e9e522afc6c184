"""The actor's account of what it produced: complete, without repeats, whatever killed its writer."""

from __future__ import annotations

from pathlib import Path

import pytest

from appl_dist.actor.produced_log import FILE, read_produced
from appl_dist.actor.spool import Spool
from appl_dist.errors import UserError
from appl_dist.wire import receipt
from appl_dist.wire.codec import decode_rollout, encode_rollout
from tests.paper_sizes import LIDAR_BEAMS
from tests.unit.wire.support import make_rollout


def blob(tag: int, transitions: int = 3) -> bytes:
    return encode_rollout(make_rollout(tag, transitions))


def test_every_rollout_and_transition_is_numbered_once_across_restarts(tmp_path: Path) -> None:
    for start in (0, 2):
        with Spool(tmp_path, "r/a") as spool:
            assert spool.produced == 3 * start + sum(range(start))
            for tag in (start, start + 1):
                spool.put(blob(tag, 3 + tag))
            spool.ack(spool.oldest)
    rows = [(e.number, e.first, e.transitions, e.seq) for e in read_produced(tmp_path / FILE)]
    assert rows == [(0, 0, 3, 0), (1, 3, 4, 1), (2, 7, 5, 2), (3, 12, 6, 3)]


def test_the_digest_is_the_same_from_the_bytes_and_from_what_replay_keeps() -> None:
    sent = blob(5, 7)
    rollout = decode_rollout(sent)
    kept = receipt.of_arrays(rollout.observations[:, LIDAR_BEAMS:], rollout.actions, rollout.rewards)
    assert receipt.of_blob(sent) == kept
    assert kept.transitions == 7
    assert receipt.of_blob(blob(6, 7)).digest != kept.digest


def test_a_process_killed_before_its_line_gets_it_at_the_next_start(tmp_path: Path) -> None:
    with Spool(tmp_path, "r/a") as spool:
        spool.put(blob(0))
        spool.put(blob(1))
    log = tmp_path / FILE
    log.write_bytes(log.read_bytes()[:-7])  # the second line is torn
    with Spool(tmp_path, "r/a") as spool:
        spool.put(blob(2))
    assert [(e.number, e.first, e.seq) for e in read_produced(log)] == [(0, 0, 0), (1, 3, 1), (2, 6, 2)]
    assert read_produced(log)[1].digest == receipt.of_blob(blob(1)).digest


def test_a_renumbered_rollout_keeps_its_own_number(tmp_path: Path) -> None:
    with Spool(tmp_path, "r/a") as spool:
        for tag in range(3):
            spool.put(blob(tag))
        spool.ack(0)
        spool.align(0)  # the learner came back without rollout 0
        assert [(e.number, e.seq) for e in read_produced(tmp_path / FILE)] == [(0, 0), (1, 0), (2, 1)]
    with Spool(tmp_path, "r/a") as spool:
        assert spool.put(blob(9)) == 2
    assert [(e.number, e.seq) for e in read_produced(tmp_path / FILE)] == [(0, 0), (1, 0), (2, 1), (3, 2)]


def test_a_log_that_is_no_log_is_a_sentence(tmp_path: Path) -> None:
    (tmp_path / FILE).write_bytes(b"what\n")
    with pytest.raises(UserError, match=r"produced\.log: line b'what' is damaged"):
        Spool(tmp_path, "r/a")
    (tmp_path / FILE).unlink()
    Spool(tmp_path, "r/a").close()
