import pytest

from appl_dist.learner.ingest import Ingest
from appl_dist.wire.codec import UploadHeader
from tests.unit.wire.support import ListStore, make_rollout


class Limiter:
    def __init__(self) -> None:
        self.open = True
        self.asked: list[int] = []

    def may_insert(self, transitions: int) -> bool:
        self.asked.append(transitions)
        return self.open


def header(seq: int, actor: str = "a", run: str = "r") -> UploadHeader:
    return UploadHeader(run, actor, "i1", 0, seq, 3)


def send(ingest: Ingest, seq: int, actor: str = "a", run: str = "r") -> tuple[str, int]:
    ack = ingest.store(header(seq, actor, run), make_rollout(seq))
    return ack.status, ack.expected


def test_each_actor_has_its_own_sequence_and_repeats_are_acked_without_storing():
    store = ListStore()
    ingest = Ingest(store, None, "r")
    assert [send(ingest, 0), send(ingest, 0), send(ingest, 1), send(ingest, 0)] == [
        ("stored", 1), ("duplicate", 1), ("stored", 2), ("duplicate", 2),
    ]  # fmt: skip
    assert send(ingest, 0, actor="b") == ("stored", 1)
    assert (store.tags("a"), store.tags("b")) == ([0, 1], [0])
    assert ingest.ledger() == {
        "a": {"rollouts": 2, "transitions": 6, "duplicates": 2, "gaps": 0, "busy": 0},
        "b": {"rollouts": 1, "transitions": 3, "duplicates": 0, "gaps": 0, "busy": 0},
    }


def test_a_rollout_ahead_of_a_missing_one_is_sent_back():
    store = ListStore()
    ingest = Ingest(store, None, "r")
    ack = ingest.store(header(2), make_rollout(2))
    assert (ack.status, ack.expected, ack.reason) == ("hello", 0, "expected rollout 0")
    assert (store.tags("a"), ingest.ledger()["a"]["gaps"]) == ([], 1)


def test_the_limiter_holds_new_rollouts_back_but_not_repeats():
    store, limiter = ListStore(), Limiter()
    ingest = Ingest(store, limiter, "r", retry_s=0.75)
    send(ingest, 0)
    limiter.open = False
    ack = ingest.store(header(1), make_rollout(1))
    assert (ack.status, ack.retry_s) == ("busy", 0.75)
    assert send(ingest, 0) == ("duplicate", 1)
    limiter.open = True
    assert send(ingest, 1) == ("stored", 2)
    assert (limiter.asked, ingest.ledger()["a"]["busy"]) == ([3, 3, 3], 1)


def test_a_large_held_fleet_is_asked_back_later():
    limiter = Limiter()
    ingest = Ingest(ListStore(), limiter, "r", retry_s=0.25)
    limiter.open = False
    acks = [ingest.store(header(0, f"a{i}"), make_rollout(0)) for i in range(500)]
    assert [acks[i].retry_s for i in (0, 15, 31, 499)] == [0.25, 0.25, 0.5, 5.0]


def test_another_run_is_refused():
    assert send(Ingest(ListStore(), None, "r"), 0, run="q")[0] == "refused"


def test_a_replay_that_cannot_store_is_not_acked_and_not_counted():
    class Full(ListStore):
        def insert(self, *_: object) -> None:
            raise OSError("disk full")

    ingest = Ingest(Full(), None, "r")
    with pytest.raises(OSError, match="disk full"):
        send(ingest, 0)
    assert ingest.ledger()["a"]["rollouts"] == 0


def test_a_restarted_ingest_goes_on_from_what_replay_holds():
    store = ListStore()
    send(Ingest(store, None, "r"), 0)
    ingest = Ingest(store, None, "r")
    assert ingest.expected_seq("a") == 1
    assert send(ingest, 0) == ("duplicate", 1)
