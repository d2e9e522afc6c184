"""Uploads over the in-memory bus: every answer, and what each side does about it."""

import threading
from dataclasses import asdict

import pytest

from appl_dist.actor.spool import Spool
from appl_dist.errors import UserError
from appl_dist.learner.ingest import Ingest
from appl_dist.wire import key_expressions as keys
from appl_dist.wire.claims import Claims
from appl_dist.wire.codec import Ack, UploadHeader, decode_header, encode_header, encode_rollout, pack
from appl_dist.wire.memory import MemoryHub
from appl_dist.wire.upload import UploadServer
from appl_dist.wire.uploader import Uploader
from tests.unit.wire.support import ListStore, ScriptedSink, make_rollout, wait_until


class Clock:
    def __init__(self) -> None:
        self.now_s = 100.0

    def __call__(self) -> float:
        return self.now_s


@pytest.fixture
def hub():
    return MemoryHub()


@pytest.fixture
def spool(tmp_path):
    with Spool(tmp_path / "spool", "run1/a0") as spool:
        yield spool


def ask(bus, header: UploadHeader | bytes, payload: bytes = b"", key: str = keys.upload("run1", "a0")) -> Ack:
    attachment = header if isinstance(header, bytes) else encode_header(header)
    answer = bus.get(key, payload, attachment, timeout_s=10)
    assert answer is not None
    return decode_header(Ack, answer.payload)


def hello(bus, seq: int = 0, run: str = "run1", actor: str = "a0") -> UploadHeader:
    return UploadHeader(run, actor, bus.identity, 0, seq, 0, hello=True)


def test_what_is_put_is_stored_once_in_order_and_forgotten(hub, spool):
    store = ListStore()
    server = UploadServer(hub.connect(), "run1", Ingest(store, None, "run1"), epoch=3)
    uploader = Uploader(hub.connect(), "run1", "a0", spool)
    uploader.start()
    for tag in range(20):
        spool.put(encode_rollout(make_rollout(tag)))
    assert uploader.close(drain_s=20)
    server.close()
    assert store.tags("a0") == list(range(20))
    assert uploader.counts == {"welcome": 1, "sent": 20, "acked": 20}
    assert server.counts == {"welcome": 1, "stored": 20}


def test_busy_and_a_failing_replay_are_retried_with_the_same_rollout(hub, spool, monkeypatch):
    monkeypatch.setattr("appl_dist.wire.upload._FAILED_RETRY_S", 0.01)
    sink = ScriptedSink(Ack("busy", retry_s=0.01), OSError("disk full"), Ack("busy", retry_s=0.01))
    server = UploadServer(hub.connect(), "run1", sink)
    uploader = Uploader(hub.connect(), "run1", "a0", spool)
    uploader.start()
    for tag in (1, 2):
        spool.put(encode_rollout(make_rollout(tag)))
    assert uploader.close(drain_s=20)
    server.close()
    assert sink.seen == [1, 2]
    assert (uploader.counts["busy"], server.counts["failed"]) == (3, 1)


def test_a_lost_ack_ends_as_a_duplicate_not_as_a_second_copy(hub, spool):
    """The learner stored it but the answer never came: the repeat is recognised."""
    store = ListStore()
    server = UploadServer(hub.connect(), "run1", Ingest(store, None, "run1"))
    bus = hub.connect()
    real_get, lost = bus.get, []

    def get(key, payload=b"", attachment=b"", timeout_s=5.0):
        answer = real_get(key, payload, attachment, timeout_s)
        if payload and len(lost) < 3:
            lost.append(answer)
            return None
        return answer

    bus.get = get
    uploader = Uploader(bus, "run1", "a0", spool)
    uploader.start()
    spool.put(encode_rollout(make_rollout(0)))
    spool.put(encode_rollout(make_rollout(1)))
    assert uploader.close(drain_s=20)
    server.close()
    assert store.tags("a0") == [0, 1]
    assert (uploader.counts["unanswered"], uploader.counts["duplicate"]) == (3, 1)


def test_a_restarted_learner_is_greeted_again(hub, spool):
    store = ListStore()
    uploader = Uploader(hub.connect(), "run1", "a0", spool)
    for epoch in (1, 2):
        server = UploadServer(hub.connect(), "run1", Ingest(store, None, "run1"), epoch=epoch)
        if epoch == 1:
            uploader.start()
        spool.put(encode_rollout(make_rollout(epoch)))
        assert spool.wait_empty(20)
        server.close()
    assert uploader.close()
    assert store.tags("a0") == [1, 2]
    assert uploader.counts["welcome"] == 2


def test_a_learner_back_with_older_files_gets_what_is_pending_under_its_own_numbers(hub, spool):
    server = UploadServer(hub.connect(), "run1", Ingest(ListStore(), None, "run1"), epoch=1)
    uploader = Uploader(hub.connect(), "run1", "a0", spool)
    uploader.start()
    spool.put(encode_rollout(make_rollout(0)))
    assert spool.wait_empty(20)
    server.close()
    store = ListStore()
    server = UploadServer(hub.connect(), "run1", Ingest(store, None, "run1"), epoch=2)
    spool.put(encode_rollout(make_rollout(1)))
    assert uploader.close(drain_s=20)
    server.close()
    assert store.tags("a0") == [1]
    assert spool.next_seq == 1


def test_a_refusal_reaches_the_next_put_and_what_is_pending_stays(hub, spool):
    sink = ScriptedSink(Ack("refused", reason="not today"))
    server = UploadServer(hub.connect(), "run1", sink)
    uploader = Uploader(hub.connect(), "run1", "a0", spool)
    uploader.start()
    spool.put(encode_rollout(make_rollout(0)))
    assert wait_until(lambda: uploader.refused)
    with pytest.raises(UserError, match="not today"):
        spool.put(b"x")
    assert not uploader.close()
    server.close()
    assert len(spool) == 1


def test_a_rollout_that_replay_can_never_store_is_refused_with_its_reason(hub, spool):
    server = UploadServer(hub.connect(), "run1", ScriptedSink(ValueError("actions: got shape (3, 7)")))
    uploader = Uploader(hub.connect(), "run1", "a0", spool)
    uploader.start()
    spool.put(encode_rollout(make_rollout(0)))
    assert wait_until(lambda: uploader.refused == "actions: got shape (3, 7)")
    uploader.close()
    server.close()
    assert (server.counts["malformed"], server.counts["failed"]) == (1, 0)


def test_no_learner_is_a_sentence(hub, spool):
    with pytest.raises(UserError, match=r"no learner of run run1 answered within 0\.1 s"):
        Uploader(hub.connect(), "run1", "a0", spool).start(timeout_s=0.1)


def test_a_learner_of_another_run_says_so(hub, spool):
    server = UploadServer(hub.connect(), "run2", ScriptedSink())
    with pytest.raises(UserError, match="got run1; the learner here is of run run2"):
        Uploader(hub.connect(), "run1", "a0", spool).start()
    server.close()


def test_a_second_live_process_of_the_same_id_is_refused_until_the_first_has_gone(hub, tmp_path):
    store = ListStore()
    server = UploadServer(hub.connect(), "run1", Ingest(store, None, "run1"))
    first_bus = hub.connect()
    spools = [Spool(tmp_path / name, "run1/a0") for name in ("first", "second")]
    first = Uploader(first_bus, "run1", "a0", spools[0])
    first.start()
    with pytest.raises(UserError, match="a0 is in use by another live process of run run1"):
        Uploader(hub.connect(), "run1", "a0", spools[1]).start()
    first.close()
    first_bus.close()
    spools[1].close()
    with Spool(tmp_path / "second", "run1/a0") as spool:
        second = Uploader(hub.connect(), "run1", "a0", spool)
        second.start()
        spool.put(encode_rollout(make_rollout(0)))
        assert second.close(drain_s=20)
    server.close()
    spools[0].close()
    assert store.tags("a0") == [0]


def test_whoever_did_not_say_hello_is_asked_to(hub):
    sink = ScriptedSink()
    server = UploadServer(hub.connect(), "run1", sink, epoch=4)
    bus = hub.connect()
    upload = UploadHeader("run1", "a0", bus.identity, 4, 0, 3)
    blob = encode_rollout(make_rollout(0))
    assert ask(bus, upload, blob).status == "hello"
    assert ask(bus, hello(bus)) == Ack("welcome", 0, epoch=4)
    assert ask(bus, UploadHeader("run1", "a0", bus.identity, 3, 0, 3), blob).status == "hello"  # old epoch
    assert ask(bus, UploadHeader("run1", "a0", "other", 4, 0, 3), blob).status == "hello"
    assert ask(bus, upload, blob).status == "stored"
    server.close()


@pytest.mark.parametrize(
    ("header", "payload", "reason"),
    [
        (b"", b"", "not msgpack"),
        (b"\x01", b"", "not a map"),
        (pack({**asdict(UploadHeader("run1", "a0", "i", 0, 0, 3)), "wire": 99}), b"", "wire version: got 99"),
        (encode_header(UploadHeader("run1", "a0", "i", 0, 0, 3)), b"junk", "checksum"),
        (encode_header(UploadHeader("run1", "a0", "i", 0, 0, 4)), encode_rollout(make_rollout(0)), "count"),
        (encode_header(UploadHeader("run1", "a1", "i", 0, 0, 3)), b"", "header of run1/a1 on key"),
        (b"", bytes((16 << 20) + 1), "payload of 16777217 bytes"),
    ],
    ids=["empty", "no map", "wire version", "payload", "count", "key", "size"],
)
def test_a_bad_message_is_counted_logged_once_and_refused_with_a_reason(hub, caplog, header, payload, reason):
    sink = ScriptedSink()
    server = UploadServer(hub.connect(), "run1", sink)
    bus = hub.connect()
    for _ in range(3):
        ack = ask(bus, header, payload)
        assert ack.status == "refused"
        assert reason in ack.reason
    assert server.counts == {"malformed": 3, "refused": 3}
    assert len([record for record in caplog.records if "refused an upload" in record.message]) == 1
    assert ask(bus, hello(bus)).status == "welcome"  # still serving
    assert sink.seen == []
    server.close()


@pytest.mark.parametrize(
    ("max_waiting", "others_ids"),
    [(16, ("b1", "b2", "b3", "b4", "b5")), (100, ("b1",) * 5)],
    ids=["of everyone", "of one actor"],
)
def test_a_full_queue_answers_busy_at_once(hub, max_waiting, others_ids):
    release, entered = threading.Event(), threading.Event()

    class Stuck(ScriptedSink):
        def expected_seq(self, actor_id: str) -> int:
            entered.set()
            release.wait(20)
            return 0

    server = UploadServer(hub.connect(), "run1", Stuck(), max_waiting=max_waiting)
    answers: list[str] = []

    def send(actor: str) -> None:
        answers.append(ask(buses[actor], hello(buses[actor], actor=actor), key=keys.upload("run1", actor)).status)

    buses = {actor: hub.connect() for actor in ("b0", *others_ids)}
    first = threading.Thread(target=send, args=("b0",))
    first.start()
    assert entered.wait(20)
    others = [threading.Thread(target=send, args=(actor,)) for actor in others_ids]
    for thread in others:
        thread.start()
    assert wait_until(lambda: len(answers) == 3)
    assert answers == ["busy"] * 3
    release.set()
    for thread in [first, *others]:
        thread.join(20)
    assert sorted(answers) == ["busy"] * 3 + ["welcome"] * 3
    server.close()


def test_strangers_cannot_fill_the_queue_of_those_who_said_hello(hub):
    release, entered = threading.Event(), threading.Event()

    class Slow(ScriptedSink):
        def expected_seq(self, actor_id: str) -> int:
            if actor_id == "slow":
                entered.set()
                release.wait(20)
            return 0

    sink = Slow()
    server = UploadServer(hub.connect(), "run1", sink, max_waiting=16)
    good, bad = hub.connect(), hub.connect()
    assert ask(good, hello(good)).status == "welcome"
    threads = [threading.Thread(target=ask, args=(bad, hello(bad, actor="slow"), b"", keys.upload("run1", "slow")))]
    threads[0].start()
    assert entered.wait(20)
    answers: list[str] = []
    for i in range(40):
        key, header = keys.upload("run1", f"b{i}"), hello(bad, actor=f"b{i}")
        thread = threading.Thread(target=lambda k=key, h=header: answers.append(ask(bad, h, b"", k).status))
        thread.start()
        threads.append(thread)
    assert wait_until(lambda: len(answers) == 38)  # two wait, the rest is turned away
    upload = UploadHeader("run1", "a0", good.identity, 0, 0, 3)
    thread = threading.Thread(target=ask, args=(good, upload, encode_rollout(make_rollout(7))))
    thread.start()
    threads.append(thread)
    release.set()
    for thread in threads:
        thread.join(20)
    assert sink.seen == [7]
    server.close()


def test_senders_of_what_was_refused_are_counted_by_name_and_logged_in_bounds(hub, caplog):
    server = UploadServer(hub.connect(), "run1", ScriptedSink())
    bus = hub.connect()
    for i in range(1100):
        ask(bus, b"junk", key=keys.upload("run1", f"b{i}"))
    for _ in range(50):
        ask(bus, b"junk", key=keys.upload("run1", "b0"))
    refused = server.refused(3)
    assert (refused["others"], refused["run1/b0"]) == (1100 - 1024, 51)
    assert server.counts["malformed"] == 1150
    assert len(caplog.records) < 40
    server.close()


def test_an_owner_without_a_token_keeps_its_id_for_the_grace_time_only(hub):
    clock = Clock()
    claims = Claims(hub.connect(), "run1", 3.0, clock)
    assert claims.take("a0", "one")
    clock.now_s += 2.9
    assert not claims.take("a0", "two")
    assert claims.holds("a0", "one")
    clock.now_s += 2.9
    assert not claims.take("a0", "two")
    clock.now_s += 0.2
    assert claims.take("a0", "two")
    assert not claims.holds("a0", "one")


def test_a_token_keeps_an_id_and_its_end_frees_it_at_once(hub):
    clock = Clock()
    claims = Claims(hub.connect(), "run1", 3.0, clock)
    token = hub.connect().announce(keys.claim("run1", "a0", "one"))
    assert claims.take("a0", "one")
    clock.now_s += 1000.0
    assert not claims.take("a0", "two")
    token.close()
    assert claims.holds("a0", "one")  # cut off for a while, nobody else came
    hub.connect().announce(keys.claim("run1", "a0", "one")).close()
    assert claims.take("a0", "two")
