"""A network that goes silent, without closing anything, for longer than the lease."""

from __future__ import annotations

import threading
import time

import pytest

from appl_dist.actor.spool import Spool
from appl_dist.learner.ingest import Ingest
from appl_dist.wire.codec import encode_rollout
from appl_dist.wire.control import ControlClient, ControlServer
from appl_dist.wire.liveness import Presence, Roster
from appl_dist.wire.session import open_session
from appl_dist.wire.upload import UploadServer
from appl_dist.wire.uploader import Uploader
from appl_dist.wire.weights import WeightsPublisher, WeightsSubscriber
from appl_dist.wire.wire_settings import WireSettings
from tests.integration.cluster import Cable
from tests.unit.wire.support import ListStore, free_endpoint, make_rollout, wait_until


@pytest.fixture
def cable():
    endpoint = free_endpoint()
    cable = Cable(int(endpoint.rsplit(":", 1)[1]))
    cable.endpoint = endpoint
    yield cable
    cable.close()


def test_a_cut_longer_than_the_lease_loses_and_repeats_nothing(cable, tmp_path):
    store, lease_s, count = ListStore(), 0.8, 120
    learner = open_session(WireSettings(cable.endpoint, lease_s=lease_s), listen=True)
    actor = open_session(WireSettings(f"tcp/127.0.0.1:{cable.port}", lease_s=lease_s), listen=False)
    roster = Roster(learner, "run1")
    server = UploadServer(learner, "run1", Ingest(store, None, "run1"), grace_s=lease_s)
    control = ControlServer(learner, "run1", "{}")
    publisher = WeightsPublisher(learner, "run1")
    publisher.publish(0, 1, b"before")

    client = ControlClient(actor, "run1")
    subscriber = WeightsSubscriber(actor, "run1")
    presence = Presence(actor, "run1", "actor", "a0")
    spool = Spool(tmp_path, "run1/a0")
    uploader = Uploader(actor, "run1", "a0", spool, timeout_s=0.5)
    uploader.start()
    assert subscriber.wait(timeout_s=20) == (0, 1, b"before")

    def produce() -> None:
        for tag in range(count):
            spool.put(encode_rollout(make_rollout(tag, transitions=20)))
            time.sleep(0.02)

    producer = threading.Thread(target=produce)
    producer.start()

    def present() -> bool:
        return any(member.role == "actor" and member.alive for member in roster.members())

    assert wait_until(lambda: len(store.tags("a0")) >= 20)
    assert present()
    cable.pull()
    assert wait_until(lambda: not present())
    assert wait_until(lambda: not client.learner_present)
    publisher.publish(0, 2, b"during")
    control.set_state("stop")
    time.sleep(2 * lease_s)
    cable.plug()
    assert wait_until(present)
    assert client.wait_stop(20)
    assert subscriber.wait((0, 1), timeout_s=20) == (0, 2, b"during")
    producer.join(60)
    assert uploader.close(drain_s=60)
    assert store.tags("a0") == list(range(count))
    for part in (presence, subscriber, client, spool, publisher, control, server, roster, actor, learner):
        part.close()
