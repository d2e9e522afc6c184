import math

import pytest

from appl_dist.wire import key_expressions as keys
from appl_dist.wire.codec import pack
from appl_dist.wire.liveness import MAX_PROGRESS_BYTES, Presence, Roster
from appl_dist.wire.memory import MemoryHub


class Clock:
    now_s = 10.0

    def __call__(self) -> float:
        return self.now_s


@pytest.fixture
def clock():
    return Clock()


@pytest.fixture
def hub():
    return MemoryHub()


def test_members_come_report_and_go(hub, clock):
    early = Presence(hub.connect(), "run1", "actor", "a0", clock=clock)
    roster = Roster(hub.connect(), "run1", clock)
    late = Presence(hub.connect(), "run1", "actor", "a1", clock=clock)
    assert [(m.member_id, m.alive, m.silent_s) for m in roster.members()] == [
        ("a0", True, math.inf),
        ("a1", True, math.inf),
    ]
    early.beat({"transitions": 100, "world": 7})
    clock.now_s += 2.0
    early.beat({"transitions": 150, "world": 8})
    late.close()
    clock.now_s += 0.5
    first, second = roster.members()
    assert (first.alive, first.silent_s, first.rate, first.progress["world"]) == (True, 0.5, 25.0, 8)
    assert (second.alive, second.progress) == (False, {})


def test_at_most_one_report_a_period(hub, clock):
    presence = Presence(hub.connect(), "run1", "actor", "a0", clock=clock)
    sent = []
    for _ in range(30):
        sent.append(presence.beat({}))
        clock.now_s += 0.1
    assert sum(sent) == 3


def test_a_restarted_process_is_one_member_and_its_rate_starts_anew(hub, clock):
    roster = Roster(hub.connect(), "run1", clock)
    first = Presence(hub.connect(), "run1", "actor", "a0", clock=clock)
    first.beat({"transitions": 100})
    second = Presence(hub.connect(), "run1", "actor", "a0", clock=clock)
    first.close()
    clock.now_s += 1
    second.beat({"transitions": 900})
    (member,) = roster.members()
    assert (member.alive, member.rate) == (True, 0.0)


@pytest.mark.parametrize(
    "data",
    [
        b"",
        b"\xc1",
        pack([]),
        pack({"wire": 99, "incarnation": "i", "progress": {}}),
        pack({"wire": 1, "incarnation": "a/b", "progress": {}}),
        pack({"wire": 1, "incarnation": "i", "progress": []}),
        bytes(MAX_PROGRESS_BYTES + 1),
    ],
)
def test_a_report_that_cannot_be_read_is_counted_and_ignored(hub, clock, data):
    roster = Roster(hub.connect(), "run1", clock)
    hub.connect().put(keys.progress("run1", "actor", "a0"), data)
    assert roster.counts["malformed"] == 1
    assert roster.members() == []


def test_other_runs_are_not_listed(hub, clock):
    roster = Roster(hub.connect(), "run1", clock)
    Presence(hub.connect(), "run2", "actor", "a0", clock=clock).beat({})
    assert roster.members() == []


def test_names_and_sizes_are_checked(hub, clock):
    with pytest.raises(ValueError, match="member_id: got 'a/0'"):
        Presence(hub.connect(), "run1", "actor", "a/0")
    with pytest.raises(ValueError, match="progress: takes"):
        Presence(hub.connect(), "run1", "actor", "a0", clock=clock).beat({"x": "y" * MAX_PROGRESS_BYTES})
