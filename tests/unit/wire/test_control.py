import pytest

from appl_dist.errors import UserError
from appl_dist.spec import WIRE_VERSION
from appl_dist.wire import key_expressions as keys
from appl_dist.wire.codec import StateHeader, encode_header, pack
from appl_dist.wire.control import ControlClient, ControlServer, fetch_run, fetch_status
from appl_dist.wire.memory import MemoryHub
from tests.unit.wire.support import wait_until


@pytest.fixture
def hub():
    return MemoryHub()


def test_an_actor_learns_run_config_and_status(hub):
    server = ControlServer(hub.connect(), "run1", '{"seed": 3}', status=lambda: {"updates": 12})
    assert fetch_run(hub.connect()) == ("run1", {"seed": 3})
    assert fetch_status(hub.connect(), "run1") == {"updates": 12}
    server.close()
    with pytest.raises(UserError, match=r"no learner answered within 0\.1 s"):
        fetch_run(hub.connect(), timeout_s=0.1)


def test_stop_reaches_actors_there_and_actors_to_come(hub):
    server = ControlServer(hub.connect(), "run1", "{}")
    early = ControlClient(hub.connect(), "run1")
    assert (early.state(), early.learner_present) == ("run", True)
    server.set_state("stop")
    assert early.wait_stop(20)
    late = ControlClient(hub.connect(), "run1")
    assert late.wait_stop(20)
    server.set_state("run")
    assert late.state() == "run"
    server.close()
    assert not early.learner_present
    early.close()
    late.close()


def test_the_larger_version_holds_and_a_restarted_learner_wins(hub):
    client = ControlClient(hub.connect(), "run1")
    bus = hub.connect()
    for epoch, version, state in ((0, 5, "stop"), (0, 4, "run")):
        bus.put(keys.state("run1"), encode_header(StateHeader("run1", epoch, version, state)))
    assert client.state() == "stop"
    server = ControlServer(hub.connect(), "run1", "{}", epoch=1)  # its token makes the client ask
    assert wait_until(lambda: client.state() == "run")
    server.close()
    client.close()


@pytest.mark.parametrize(
    "data",
    [b"", bytes(5000), pack({}), encode_header(StateHeader("run2", 9, 9, "stop"))],
)
def test_a_state_that_cannot_be_read_is_counted_and_ignored(hub, data):
    client = ControlClient(hub.connect(), "run1")
    hub.connect().put(keys.state("run1"), data)
    assert (client.state(), client.counts["malformed"]) == ("run", 1)
    client.close()


@pytest.mark.parametrize(
    ("answer", "message"),
    [
        (b"junk", "cannot be read"),
        (pack({"wire": 99, "run": "run1", "config": "{}"}), "wire version: the learner speaks 99"),
        (pack({"wire": WIRE_VERSION, "run": "a/b", "config": "{}"}), "describes its run as 'a/b'"),
        (pack({"wire": WIRE_VERSION, "run": "run1", "config": "["}), "describes its run"),
        (pack({"wire": WIRE_VERSION, "run": "run1", "config": "[]"}), "describes its run"),
        (pack({"wire": WIRE_VERSION, "run": "run1", "config": '{"a":' + "[" * 400_000}), "describes its run"),
        (pack({"wire": WIRE_VERSION, "run": "run1", "config": '{"a":' * 99 + "1" + "}" * 99}), "describes its run"),
        (bytes(2 << 20), "cannot be read"),
    ],
)
def test_a_run_that_cannot_be_read_is_a_sentence(hub, answer, message):
    hub.connect().serve(keys.RUN, lambda query: query.reply(answer))
    with pytest.raises(UserError, match=message):
        fetch_run(hub.connect())


def test_a_status_that_fails_leaves_the_learner_serving(hub):
    server = ControlServer(hub.connect(), "run1", "{}", status=lambda: 1 // 0)
    assert "ZeroDivisionError" in fetch_status(hub.connect(), "run1")["error"]
    assert fetch_run(hub.connect())[0] == "run1"
    server.close()


@pytest.mark.parametrize("config", ["[]", "{", "x" * (1 << 20)])
def test_the_config_must_be_a_json_object(hub, config):
    with pytest.raises(ValueError, match="config_json: expected a JSON object"):
        ControlServer(hub.connect(), "run1", config)
