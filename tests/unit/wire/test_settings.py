import pytest

from appl_dist.errors import UserError
from appl_dist.wire.settings import WireSettings


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
        ({"user": "a"}, "give both or neither"),
        ({"users_file": "/nowhere/users"}, "wire.users_file: no file at /nowhere/users"),
        ({"endpoint": "tls/localhost:7447"}, "wire.tls_ca"),
        ({"tls_certificate": __file__}, "wire.tls_certificate, wire.tls_key"),
    ],
)
def test_a_wrong_field_is_named(values, message):
    with pytest.raises(UserError, match=message):
        WireSettings(**values)


def test_the_password_is_not_shown():
    assert "hidden" not in repr(WireSettings(user="a", password="hidden"))
