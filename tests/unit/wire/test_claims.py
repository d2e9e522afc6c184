"""Who owns an actor id, with tokens that come and go on the in-memory bus."""

from __future__ import annotations

from appl_dist.wire import key_expressions as keys
from appl_dist.wire.claims import Claims
from appl_dist.wire.memory import MemoryHub


def test_last_words_of_a_killed_process_do_not_keep_its_successor_out() -> None:
    hub = MemoryHub()
    bus = hub.connect()
    claims = Claims(bus, "run", grace_s=3.0, clock=lambda: 100.0)
    token = bus.announce(keys.claim("run", "a0", "first"))
    assert claims.take("a0", "first")
    assert not claims.take("a0", "second")
    token.close()  # killed; an upload of its is still in the learner's queue
    assert claims.holds("a0", "first")
    assert claims.take("a0", "second")
    assert not claims.holds("a0", "first")


def test_a_process_whose_token_returns_owns_its_id_again() -> None:
    hub = MemoryHub()
    bus = hub.connect()
    claims = Claims(bus, "run", grace_s=3.0, clock=lambda: 100.0)
    bus.announce(keys.claim("run", "a0", "first")).close()
    assert claims.take("a0", "first")
    token = bus.announce(keys.claim("run", "a0", "first"))
    assert claims.holds("a0", "first")
    assert not claims.take("a0", "second")
    token.close()
    assert claims.take("a0", "second")
