import pytest

from appl_dist.errors import UserError
from appl_dist.wire.wire_settings import WireSettings


def test_the_default_is_this_machine_only():
    assert WireSettings().is_loopback
    assert not WireSettings(endpoint="tcp/0.0.0.0:7447").is_loopback


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"endpoint": "localhost:7447"}, "wire.endpoint: got 'localhost:7447'"),
        ({"endpoint": "udp/localhost:7447"}, "wire.endpoint"),
        ({"endpoint": "tcp/localhost:0"}, "wire.endpoint"),
        ({"endpoint": "tcp/localhost:70000"}, "wire.endpoint"),
        ({"lease_s": 0.1}, "wire.lease_s: got 0.1 s; allowed 0.5..60 s"),
        ({"timeout_s": float("nan")}, "wire.timeout_s"),
        ({"security": "some"}, "wire.security: got 'some'; allowed auto, none, password, tls"),
        ({"endpoint": "tls/localhost:7447"}, "tls/HOST:PORT goes with security=tls"),
        ({"security": "tls", "keys": "k"}, "wire.endpoint: got tcp/127.0.0.1:7447 with wire.security=tls"),
        ({"security": "password"}, "wire.keys: got '' with wire.security=password"),
        ({"keys": "k", "security": "none"}, "wire.keys: got 'k' with wire.security=none"),
    ],
)
def test_a_wrong_field_is_named(values, message):
    with pytest.raises(UserError, match=message):
        WireSettings(**values)


def test_a_client_of_a_learner_on_every_interface_connects_to_this_machine():
    assert WireSettings("tcp/0.0.0.0:7447").connect_endpoint == "tcp/127.0.0.1:7447"
    assert WireSettings("tls/h0.0.0.0:1", security="tls", keys="k").connect_endpoint == "tls/h0.0.0.0:1"


def test_keys_alone_say_how_they_are_used() -> None:
    assert WireSettings(keys="k").security == "password"
    assert WireSettings("tls/localhost:7447", keys="k").security == "tls"
    assert WireSettings().is_open and WireSettings(security="none").is_open
