from dataclasses import asdict

import pytest

from appl_dist.wire import key_expressions as keys
from appl_dist.wire.codec import WeightsHeader, encode_header, pack
from appl_dist.wire.memory import MemoryHub
from appl_dist.wire.weights import WeightsPublisher, WeightsSubscriber
from tests.unit.wire.support import wait_until


@pytest.fixture
def hub():
    return MemoryHub()


@pytest.fixture
def subscriber(hub):
    subscriber = WeightsSubscriber(hub.connect(), "run1", poll_s=30.0)
    yield subscriber
    subscriber.close()


def header(epoch: int, version: int, size: int, run: str = "run1") -> bytes:
    return encode_header(WeightsHeader(run, epoch, version, size))


def test_what_is_published_arrives_and_a_late_joiner_gets_the_newest(hub, subscriber):
    publisher = WeightsPublisher(hub.connect(), "run1")
    publisher.publish(0, 1, b"one")
    assert subscriber.wait() == (0, 1, b"one")
    publisher.publish(0, 2, b"two")
    assert subscriber.wait((0, 1)) == (0, 2, b"two")
    late = WeightsSubscriber(hub.connect(), "run1")
    assert late.wait() == (0, 2, b"two")
    assert late.counts["fetched"] == 1
    late.close()
    publisher.close()


def test_the_larger_epoch_and_version_stays_whatever_the_order(hub, subscriber):
    bus = hub.connect()
    for epoch, version in ((0, 5), (0, 4), (1, 0), (0, 9), (1, 0)):
        bus.put(keys.weights("run1"), b"%d.%d" % (epoch, version), header(epoch, version, 3))
    assert subscriber.latest() == (1, 0, b"1.0")
    assert subscriber.counts == {"received": 2, "old": 3}


def test_a_lost_message_is_made_up_for_when_the_learner_returns(hub, subscriber):
    publisher = WeightsPublisher(hub.connect(), "run1")
    publisher.publish(0, 1, b"one")
    assert subscriber.wait() is not None
    subscriber._subscription.close()  # from here on, nothing pushed arrives
    publisher.publish(0, 2, b"two")
    assert wait_until(lambda: publisher.sent == 2)
    assert subscriber.latest() == (0, 1, b"one")
    token = hub.connect().announce(keys.alive("run1", "learner", "learner", "i2"))
    assert subscriber.wait((0, 1)) == (0, 2, b"two")
    token.close()
    publisher.close()


def test_asking_costs_no_blob_when_there_is_nothing_newer(hub):
    publisher = WeightsPublisher(hub.connect(), "run1")
    publisher.publish(0, 3, b"three")
    bus = hub.connect()
    sizes = [
        bus.get(keys.weights("run1"), b"", header(0, have, size)).size
        for have, size in ((0, 0), (2, 5), (3, 5), (4, 5))
    ]
    assert sizes == [5, 5, 0, 0]
    assert bus.get(keys.weights("run1"), b"", b"junk").size == 5
    publisher.close()


def test_the_newest_supersedes_what_was_not_sent(hub):
    publisher = WeightsPublisher(hub.connect(), "run1")
    for version in range(1, 500):
        publisher.publish(0, version, b"x")
    assert hub.connect().get(keys.weights("run1")).attachment == header(0, 499, 1)
    publisher.close()


@pytest.mark.parametrize(
    ("attachment", "payload"),
    [
        (b"", b"x"),
        (header(0, 1, 2), b"x"),
        (header(0, 1, 0), b""),
        (header(0, 1, 1, run="run2"), b"x"),
        (pack({**asdict(WeightsHeader("run1", 0, 1, 1)), "wire": 99}), b"x"),
        (header(0, 1, 3), b"bad"),
    ],
)
def test_weights_that_cannot_be_are_counted_and_ignored(hub, attachment, payload):
    def check(blob: bytes) -> None:
        if blob == b"bad":
            raise ValueError("not a policy")

    subscriber = WeightsSubscriber(hub.connect(), "run1", check=check)
    hub.connect().put(keys.weights("run1"), payload, attachment)
    assert subscriber.latest() is None
    assert subscriber.counts == {"malformed": 1}
    subscriber.close()


def test_publishing_backwards_or_nothing_is_an_error(hub):
    publisher = WeightsPublisher(hub.connect(), "run1")
    publisher.publish(1, 1, b"x")
    for epoch, version, blob in ((1, 1, b"y"), (0, 9, b"y"), (1, 2, b""), (1, -1, b"y")):
        with pytest.raises(ValueError, match="got"):
            publisher.publish(epoch, version, blob)
    publisher.close()


def test_waiting_ends_without_a_policy(subscriber):
    assert subscriber.wait(timeout_s=0.01) is None
