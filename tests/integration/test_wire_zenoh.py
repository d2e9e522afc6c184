"""The wire over zenoh sessions within this process: what sockets add to the unit tests."""

from __future__ import annotations

from dataclasses import asdict

import pytest

from appl_dist.errors import PassingFault, UserError
from appl_dist.learner.ingest import Ingest
from appl_dist.spec import WIRE_VERSION
from appl_dist.wire import key_expressions as keys
from appl_dist.wire import session as wire_session
from appl_dist.wire.codec import (
    Ack,
    UploadHeader,
    WeightsHeader,
    decode_header,
    encode_header,
    pack,
)
from appl_dist.wire.control import ControlClient, ControlServer, fetch_run
from appl_dist.wire.session import Session, open_session
from appl_dist.wire.upload import UploadServer
from appl_dist.wire.weights import WeightsPublisher, WeightsSubscriber
from appl_dist.wire.wire_settings import WireSettings
from tests.unit.wire.support import ListStore, free_endpoint, wait_until


@pytest.fixture
def settings():
    return WireSettings(free_endpoint(), lease_s=1.0, timeout_s=1.0)


@pytest.fixture
def learner(settings):
    with open_session(settings, listen=True) as session:
        yield session


@pytest.fixture
def actor(settings, learner):
    with open_session(settings, listen=False) as session:
        yield session


def reopen(session: Session, settings: WireSettings) -> Session:
    session.close()
    return open_session(settings, listen=True)


def test_a_taken_port_is_a_sentence(settings, learner):
    with pytest.raises(UserError, match=f"{settings.endpoint} is already in use"):
        open_session(settings, listen=True)


def test_no_learner_is_a_sentence_with_both_causes(settings):
    with pytest.raises(UserError, match=r"no learner runs there, or it refused the credentials"):
        open_session(settings, listen=False)


def test_one_more_than_the_learner_takes_is_a_sentence_with_the_bound(settings, monkeypatch):
    monkeypatch.setattr(wire_session, "MAX_CONNECTIONS", 2)
    with open_session(settings, listen=True), open_session(settings, listen=False):
        with (
            open_session(settings, listen=False),
            pytest.raises(PassingFault, match=r"it already has its 4,000 actors"),
        ):
            open_session(settings, listen=False)
        with open_session(settings, listen=False) as next_one:  # the place of one that has gone is free
            assert next_one.identity


def test_a_host_that_is_not_ours_cannot_be_listened_on():
    with pytest.raises(UserError, match=r"cannot listen on tcp/192\.0\.2\.1:7447"):
        open_session(WireSettings("tcp/192.0.2.1:7447"), listen=True)


def test_weights_reach_subscribers_there_and_to_come_and_a_restarted_learner_wins(settings, learner, actor):
    blob = bytes(range(256)) * 14_000  # 3.6 MB
    publisher = WeightsPublisher(learner, "run1")
    early = WeightsSubscriber(actor, "run1")
    publisher.publish(1, 7, blob)
    assert early.wait(timeout_s=20) == (1, 7, blob)
    with open_session(settings, listen=False) as another:
        late = WeightsSubscriber(another, "run1")
        assert late.wait(timeout_s=20) == (1, 7, blob)
        late.close()
    publisher.close()
    with reopen(learner, settings) as restarted:
        publisher = WeightsPublisher(restarted, "run1")
        publisher.publish(2, 0, b"restored")  # perhaps before the actor is back: then its token brings it
        server = ControlServer(restarted, "run1", "{}", epoch=2)
        assert early.wait((1, 7), timeout_s=20) == (2, 0, b"restored")
        server.close()
        publisher.close()
    early.close()


def test_state_and_presence_come_back_with_the_learner(settings, learner, actor):
    server = ControlServer(learner, "run1", '{"seed": 1}', epoch=1)
    assert fetch_run(actor) == ("run1", {"seed": 1})
    client = ControlClient(actor, "run1")
    assert wait_until(lambda: client.learner_present)
    server.close()
    learner.close()
    assert wait_until(lambda: not client.learner_present)
    with open_session(settings, listen=True) as restarted:
        server = ControlServer(restarted, "run1", "{}", epoch=2)
        assert wait_until(lambda: client.learner_present)
        server.set_state("stop")
        assert client.wait_stop(20)
        server.close()
    client.close()


def test_an_actor_of_another_wire_version_is_refused_by_name(learner, actor):
    server = UploadServer(learner, "run1", Ingest(ListStore(), None, "run1"))
    header = asdict(UploadHeader("run1", "a0", actor.identity, 0, 0, 0, hello=True))
    answer = actor.get(keys.upload("run1", "a0"), b"", pack({**header, "wire": WIRE_VERSION + 1}))
    assert answer is not None
    ack = decode_header(Ack, answer.payload)
    assert ack.status == "refused"
    assert f"wire version: got {WIRE_VERSION + 1}, this side speaks {WIRE_VERSION}" in ack.reason
    server.close()


def test_nobody_but_the_learner_can_say_what_the_learner_says(settings, learner, actor):
    subscriber = WeightsSubscriber(actor, "run1", poll_s=0.1)
    with open_session(settings, listen=False) as rogue:
        rogue.serve(keys.weights("run1"), lambda query: query.reply(b"x", header))
        rogue.serve(keys.upload("*", "*"), lambda query: query.reply(encode_header(Ack("stored"))))
        rogue.announce(keys.alive("run1", "learner", "learner", rogue.identity))
        client = ControlClient(actor, "run1", poll_s=0.1)
        header = encode_header(WeightsHeader("run1", 9, 9, 1))
        for _ in range(20):
            rogue.put(keys.weights("run1"), b"x", header)
        assert actor.get(keys.upload("run1", "a0"), b"", b"", timeout_s=0.5) is None
        publisher = WeightsPublisher(learner, "run1")
        publisher.publish(0, 1, b"real")
        assert subscriber.wait(timeout_s=20) == (0, 1, b"real")
        assert not client.learner_present
        client.close()
        publisher.close()
    subscriber.close()
