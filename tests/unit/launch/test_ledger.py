"""The ledger finds what is missing, doubled or unknown, also after the ring has overwritten old rollouts."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest

from appl_dist.actor.spool import Spool
from appl_dist.errors import UserError
from appl_dist.launch.ledger import Ledger, audit, run_ledger
from appl_dist.learner.replay import Replay
from appl_dist.wire.codec import decode_rollout, encode_rollout
from tests.paper_sizes import SIZES
from tests.unit.wire.support import make_rollout


@pytest.fixture
def spool(tmp_path: Path) -> Iterator[Spool]:
    with Spool(tmp_path / "spool" / "a0", "run/a0") as spool:
        for tag in range(6):
            spool.put(encode_rollout(make_rollout(tag, 3 + tag)))  # 33 transitions
        yield spool


def deliver(spool: Spool, replay: Replay, count: int) -> None:
    for _ in range(count):
        seq, blob = spool.peek() or (0, b"")
        replay.ring.insert(decode_rollout(blob), "a0", seq)
        spool.ack(seq)


def of(replay: Replay, spool: Spool) -> Ledger:
    return audit(replay, [spool.folder])


def test_what_was_sent_is_stored_or_waiting(spool: Spool) -> None:
    with Replay(None, 1000, 1, 0.99, **SIZES) as replay:
        deliver(spool, replay, 4)
        ledger = of(replay, spool)
    account = ledger.accounts["a0"]
    assert (account.rollouts, account.sent, account.stored, account.waiting) == (6, 33, 18, 15)
    assert ledger.agrees
    assert "lost 0, duplicate 0: the accounts agree" in ledger.sentence()


def test_what_the_ring_has_overwritten_counts_by_its_number(spool: Spool) -> None:
    with Replay(None, 16, 1, 0.99, **SIZES) as replay:
        deliver(spool, replay, 6)
        assert len(replay.ring) < 33
        ledger = of(replay, spool)
    assert ledger.accounts["a0"].stored == 33
    assert ledger.agrees


def test_a_rollout_in_neither_place_is_lost(spool: Spool) -> None:
    spool.ack(0)  # nobody stored it
    with Replay(None, 1000, 1, 0.99, **SIZES) as replay:
        spool.align(0)
        deliver(spool, replay, 5)
        ledger = of(replay, spool)
    assert (ledger.accounts["a0"].lost, ledger.accounts["a0"].stored) == (3, 30)
    assert not ledger.agrees


def test_a_rollout_stored_twice_is_found(spool: Spool) -> None:
    with Replay(None, 1000, 1, 0.99, **SIZES) as replay:
        deliver(spool, replay, 6)
        replay.ring.insert(decode_rollout(encode_rollout(make_rollout(2, 5))), "a0", 6)
        ledger = of(replay, spool)
    assert ledger.accounts["a0"].duplicate == 5
    assert "THE ACCOUNTS DO NOT AGREE" in ledger.sentence()


def test_a_rollout_of_no_log_is_found(spool: Spool) -> None:
    with Replay(None, 1000, 1, 0.99, **SIZES) as replay:
        deliver(spool, replay, 6)
        replay.ring.insert(make_rollout(77), "a1", 0)
        ledger = of(replay, spool)
    assert ledger.accounts["a1"].unknown == 3
    assert not ledger.agrees


def test_a_run_folder_is_read_whole_and_spools_elsewhere_are_added(spool: Spool, tmp_path: Path) -> None:
    with Replay(tmp_path / "replay", 1000, 1, 0.99, **SIZES) as replay:
        deliver(spool, replay, 6)
        with Spool(tmp_path / "far" / "a1", "run/a1") as far:
            far.put(encode_rollout(make_rollout(9)))
            replay.ring.insert(make_rollout(9), "a1", 0)
            far.ack(0)
    assert run_ledger(tmp_path, [tmp_path / "far"]).agrees
    assert not run_ledger(tmp_path).agrees
    with pytest.raises(UserError, match="no folder at"):
        run_ledger(tmp_path, [tmp_path / "nowhere"])
    with pytest.raises(UserError, match="is no run's folder"):
        run_ledger(tmp_path / "nowhere")
