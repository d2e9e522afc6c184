"""Jobs over the wire: each result counts once, whatever workers do."""

from __future__ import annotations

import threading
from dataclasses import asdict
from typing import Any

import pytest

from appl_dist.errors import UserError
from appl_dist.spec import WIRE_VERSION
from appl_dist.wire import key_expressions as keys
from appl_dist.wire.codec import pack
from appl_dist.wire.memory import MemoryHub, MemorySession
from appl_dist.wire.work import ALONE_S, MAX_FAILURES, PATIENCE_S, WorkClient, WorkServer
from appl_dist.wire.work_messages import Answer, Question, decode_message, encode


def read(job: int, received: dict[str, Any]) -> dict[str, Any]:
    if received.get("square") != job * job:
        raise ValueError(f"result: got {received}")
    return received


def question(**changes: Any) -> bytes:
    """A question with some fields changed, whatever they are."""
    return pack({"wire": WIRE_VERSION, **asdict(Question("i")), **changes})


class Place:
    """A server of `count` jobs on a hub, its clock by hand, and all it has yielded."""

    def __init__(self, count: int) -> None:
        self.hub, self.now_s = MemoryHub(), 0.0
        jobs = [{"number": i} for i in range(count)]
        self.server = WorkServer(self.hub.connect(), "r", jobs, {"a.bin": b"abc"}, read, clock=lambda: self.now_s)

    def worker(self, name: str) -> tuple[MemorySession, WorkClient]:
        bus = self.hub.connect()
        return bus, WorkClient(bus, "r", name, lambda: False, away_s=0.5)

    def collect(self) -> dict[int, dict[str, Any]]:
        return dict(self.server.results())


def work(client: WorkClient, limit: int = 10**6) -> int:
    done, made = None, 0
    while made < limit:
        job = client.next(done)
        if job is None:
            return made
        number = job.what["number"]
        done = job, {"square": number * number}
        made += 1
    return made


def test_every_job_is_done_once_by_several_workers() -> None:
    place = Place(40)
    threads = [threading.Thread(target=work, args=(place.worker(f"actor-{i}")[1],)) for i in range(4)]
    for thread in threads:
        thread.start()
    found = place.collect()
    for thread in threads:
        thread.join()
    assert found == {i: {"square": i * i} for i in range(40)}
    assert place.server.counts == {"handed": 40, "results": 40}


def test_a_job_of_a_worker_that_has_gone_is_handed_out_again_and_its_late_result_does_not_count() -> None:
    place = Place(2)
    gone_bus, gone = place.worker("actor-0")
    token = gone_bus.announce(keys.alive("r", "actor", "actor-0", gone_bus.identity))
    held = gone.next()
    assert held is not None
    token.close()
    assert work(place.worker("actor-1")[1]) == 2
    assert gone.next((held, {"square": held.what["number"] ** 2})) is None
    assert len(place.collect()) == 2
    assert place.server.counts["repeated"] == 1
    assert place.server.counts["again"] == 1


def test_a_job_that_is_out_for_long_goes_to_an_idle_worker_too() -> None:
    place = Place(1)
    assert place.worker("actor-0")[1].next() is not None  # and then hangs
    bus, _ = place.worker("actor-1")
    assert ask(bus, "actor-1") == Answer()
    place.now_s = PATIENCE_S + 1.0
    assert ask(bus, "actor-1").job == 0


def test_a_worker_whose_answer_was_lost_gets_the_same_job() -> None:
    place = Place(2)
    bus, client = place.worker("actor-0")
    assert ask(bus, "actor-0").job == 0  # never arrives
    job = client.next()
    assert job is not None
    assert job.job == 0


def test_files_are_served_and_only_those() -> None:
    _, client = Place(1).worker("actor-0")
    assert client.file("a.bin") == b"abc"
    with pytest.raises(UserError, match="no file"):
        client.file("../secret")


@pytest.mark.parametrize(
    "message",
    [
        b"nonsense",
        question(wire=WIRE_VERSION + 1),
        question(job=7, result={}),
        question(job="0", result={}),
        question(job=False, result={"square": 0}),
        question(job=0, result={"square": 5}),
        question(job=0, result=5),
        question(job=0),
        question(job=0, result={"square": 0}, failed="x"),
        question(file=["a.bin"]),
        question(file={}),
        question(failed="a\nb"),
        question(failed="x" * 2001),
        question(incarnation="a/b"),
        question(more=1),
        b"\0" * (2 << 20),
    ],
)
def test_what_cannot_be_is_refused_and_changes_nothing(message: bytes) -> None:
    place = Place(1)
    bus, client = place.worker("actor-0")
    answer = bus.get(keys.work("r", "actor-1"), message)
    assert answer is not None
    assert decode_message(Answer, answer.payload, 1 << 20).error
    assert place.server.counts == {"malformed": 1}
    assert work(client) == 1
    assert place.collect() == {0: {"square": 0}}


def test_a_worker_that_fails_is_excluded_and_another_does_its_job() -> None:
    place = Place(3)
    _, bad = place.worker("actor-0")
    assert bad.next() is not None
    bad.fail("no worlds here")
    assert bad.next() is None
    assert work(place.worker("actor-1")[1]) == 3
    assert sorted(place.collect()) == [0, 1, 2]
    assert place.server.counts["failed"] == 1


def test_a_job_at_which_several_workers_fail_ends_the_whole_with_their_words() -> None:
    place = Place(3)
    for i in range(MAX_FAILURES):
        client = place.worker(f"actor-{i}")[1]
        assert client.next() is not None
        client.fail("no worlds here")
    with pytest.raises(UserError, match=f"failed at the same job; the last: actor-{MAX_FAILURES - 1}: no worlds here"):
        place.collect()


def test_when_every_worker_has_failed_the_whole_ends_with_their_words() -> None:
    place = Place(3)
    place.worker("actor-0")[1].fail("no worlds here")
    place.now_s += ALONE_S + 1.0
    with pytest.raises(UserError, match="no worker is left: actor-0: no worlds here"):
        place.collect()


def test_nobody_there_is_said() -> None:
    client = WorkClient(MemoryHub().connect(), "r", "actor-0", lambda: False, away_s=0.3)
    with pytest.raises(UserError, match="nobody has answered"):
        client.next()


@pytest.mark.parametrize(
    "answer",
    [
        pack({"wire": WIRE_VERSION + 1}),
        pack({"wire": WIRE_VERSION, **asdict(Answer()), "job": True, "what": {}}),
        pack({"wire": WIRE_VERSION, **asdict(Answer()), "job": 1, "what": [1]}),
        pack({"wire": WIRE_VERSION, **asdict(Answer()), "over": "no"}),
        pack({"wire": WIRE_VERSION, **asdict(Answer()), "error": "a\nb"}),
        pack({"wire": WIRE_VERSION, **asdict(Answer()), "file": "text"}),
    ],
)
def test_an_answer_that_cannot_be_read_is_a_sentence(answer: bytes) -> None:
    hub = MemoryHub()
    hub.connect().serve(keys.work("r", "actor-0"), lambda query: query.reply(answer))
    client = WorkClient(hub.connect(), "r", "actor-0", lambda: False, away_s=0.5)
    with pytest.raises(UserError, match="evaluation: an answer that cannot be read: ") as caught:
        client.next()
    assert "\n" not in str(caught.value)


def test_refused_senders_are_logged_once_each_and_only_the_first(caplog: pytest.LogCaptureFixture) -> None:
    place = Place(1)
    bus, _ = place.worker("actor-0")
    for i in range(200):
        bus.get(keys.work("r", f"bad-{i % 100}"), b"nonsense")
    assert place.server.counts == {"malformed": 200}
    assert len(caplog.records) == 20


def test_a_long_reason_keeps_its_end_on_one_line() -> None:
    place = Place(1)
    place.worker("actor-0")[1].fail("Traceback\n" + "x" * 5000 + "\nKeyError: 'lidar'\n")
    place.now_s += ALONE_S + 1.0
    with pytest.raises(UserError, match=r"x\\nKeyError: 'lidar'$"):
        place.collect()


def ask(bus: MemorySession, worker: str) -> Answer:
    answer = bus.get(keys.work("r", worker), encode(Question(bus.identity)))
    assert answer is not None
    return decode_message(Answer, answer.payload, 1 << 20)
