import math
from dataclasses import asdict

import pytest

from appl_dist.spec import WIRE_VERSION
from appl_dist.wire import key_expressions as keys
from appl_dist.wire.codec import pack
from appl_dist.wire.liveness import MAX_PROGRESS_BYTES, Presence, Roster
from appl_dist.wire.memory import MemoryHub
from appl_dist.wire.run_status import Progress


def progress(**changes):
    """A well-formed report, but for `changes`."""
    return pack({"wire": WIRE_VERSION, "incarnation": "i", "progress": {**asdict(Progress()), **changes}})


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
    early.beat(Progress(transitions=100, world=7))
    clock.now_s += 2.0
    early.beat(Progress(transitions=150, world=8))
    late.close()
    clock.now_s += 0.5
    first, second = roster.members()
    assert (first.alive, first.silent_s, first.rate, first.progress) == (
        True,
        0.5,
        25.0,
        Progress(transitions=150, world=8),
    )
    assert (second.alive, second.progress) == (False, None)


def test_at_most_one_report_a_period(hub, clock):
    presence = Presence(hub.connect(), "run1", "actor", "a0", clock=clock)
    sent = []
    for _ in range(30):
        sent.append(presence.beat(Progress()))
        clock.now_s += 0.1
    assert sum(sent) == 3


def test_a_restarted_process_is_one_member_and_its_rate_starts_anew(hub, clock):
    roster = Roster(hub.connect(), "run1", clock)
    first = Presence(hub.connect(), "run1", "actor", "a0", clock=clock)
    first.beat(Progress(transitions=100))
    second = Presence(hub.connect(), "run1", "actor", "a0", clock=clock)
    first.close()
    clock.now_s += 1
    second.beat(Progress(transitions=900))
    (member,) = roster.members()
    assert (member.alive, member.rate) == (True, 0.0)


@pytest.mark.parametrize(
    "data",
    [
        b"",
        b"\xc1",
        pack([]),
        pack({"wire": 99, "incarnation": "i", "progress": {}}),
        pack({"wire": WIRE_VERSION, "incarnation": "a/b", "progress": {}}),
        pack({"wire": WIRE_VERSION, "incarnation": "i", "progress": []}),
        bytes(MAX_PROGRESS_BYTES + 1),
        *(
            progress(**change)
            for change in (
                {"pending": "x"},
                {"pending": -1},
                {"pending": 10**9},
                {"world": "[/x]"},
                {"world": 1.5},
                {"world": True},
                {"transitions": 2**63},
                {"host": 7},
                {"host": "a\x1b[31m"},
                {"host": "x" * 300},
                {"host": "a\nb"},
                {"more": 1},
                {"policy_version": [1]},
                {"policy_version": float("nan")},
                {"transitions": {"a": {}}},
            )
        ),
        pack({"wire": WIRE_VERSION, "incarnation": "i", "progress": {"world": 1}}),
    ],
)
def test_a_report_that_cannot_be_read_is_counted_and_ignored(hub, clock, data):
    roster = Roster(hub.connect(), "run1", clock)
    hub.connect().put(keys.progress("run1", "actor", "a0"), data)
    assert roster.counts["malformed"] == 1
    assert roster.members() == []


def test_other_runs_are_not_listed(hub, clock):
    roster = Roster(hub.connect(), "run1", clock)
    Presence(hub.connect(), "run2", "actor", "a0", clock=clock).beat(Progress())
    assert roster.members() == []


def test_names_are_checked(hub):
    with pytest.raises(ValueError, match="member_id: got 'a/0'"):
        Presence(hub.connect(), "run1", "actor", "a/0")


def test_keys_that_are_no_names_make_no_members(hub, clock):
    roster = Roster(hub.connect(), "run1", clock)
    hub.connect().put("appl/run1/progress/actor/[red]", progress())
    hub.connect().announce("appl/run1/alive/actor/a b/i")
    assert roster.counts["malformed"] == 2
    assert roster.members() == []
