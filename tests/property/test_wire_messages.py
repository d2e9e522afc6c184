"""Messages of any content: a decoder gives a value of its type and bounds, or ValueError; a server always answers."""

from __future__ import annotations

from dataclasses import asdict
from typing import Any

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from appl_dist.spec import WIRE_VERSION
from appl_dist.wire import key_expressions as keys
from appl_dist.wire.codec import Ack, StateHeader, UploadHeader, WeightsHeader, decode_header, pack
from appl_dist.wire.control import MAX_STATUS_BYTES, ControlServer, fetch_run_status
from appl_dist.wire.memory import MemoryHub
from appl_dist.wire.run_status import ActorStatus, EpisodeInfo, Progress, RunStatus
from appl_dist.wire.typed import MAX_COUNT, MAX_TEXT, decode
from appl_dist.wire.wire_settings import MAX_CONNECTIONS
from appl_dist.wire.work import WorkClient, WorkServer
from appl_dist.wire.work_messages import Answer, Question, decode_message, encode

ACTOR = ActorStatus("a", 1.0, 0, 0, 0, 0.0, "h")
STATUS = RunStatus(
    "run", 1, 1, 1, 1.0, 0.0, 1.0, 1.0, 1.0, 0, 1, 0.1, 0, None, None, None, 0.0, 0.0, {"a": 1}, "", (ACTOR,)
)
MAPS = [Progress(), EpisodeInfo(0, True, True, 1.0, 1.0, 0, 0), ACTOR, STATUS, Question("i"), Answer()]
HEADERS = [
    UploadHeader("r", "a", "i", 0, 0, 1),
    Ack("stored"),
    WeightsHeader("r", 0, 0, 1),
    StateHeader("r", 0, 0, "run"),
]

TEXTS = st.sampled_from(["", "x", "[/x]", "a\nb", "\x1b[2J", "é" * 300, "a/b", "run", "stop"])
NUMBERS = st.integers(-(2**63), 2**64 - 1) | st.floats() | st.sampled_from([2**53, 2**53 + 1, -1, -1.0])
PLAIN = st.none() | st.booleans() | NUMBERS | TEXTS | st.binary(max_size=4)
VALUES = st.recursive(PLAIN, lambda inside: st.lists(inside, max_size=3) | st.dictionaries(TEXTS, inside, max_size=3))


def changes(names: Any) -> st.SearchStrategy[dict[str, Any]]:
    return st.dictionaries(st.sampled_from(sorted(names)), VALUES, min_size=1, max_size=4)


def within_bounds(value: Any) -> bool:
    """Whether every number is finite and bounded, and every text printable; also inside."""
    if isinstance(value, dict):
        return all(within_bounds(k) and within_bounds(v) for k, v in value.items())
    if isinstance(value, list | tuple):
        return all(map(within_bounds, value))
    if isinstance(value, str):
        return value.isprintable()
    return not isinstance(value, int | float) or abs(value) <= 1e300


@pytest.mark.parametrize("good", MAPS, ids=lambda good: type(good).__name__)
@given(data=st.data())
def test_a_map_becomes_a_bounded_value_or_is_refused(good: Any, data: st.DataObject) -> None:
    received = {**asdict(good), **data.draw(changes(asdict(good)))}
    try:
        value = decode(type(good), received)
    except ValueError:
        return
    opaque = ("result", "what")  # for the reader's own check
    plain = {name: field for name, field in asdict(value).items() if name not in opaque}
    for name, field in plain.items():
        assert type(field) is type(received[name]) or isinstance(field, float | tuple), name
    if not isinstance(value, RunStatus | ActorStatus):  # whose floats are unbounded, but finite
        assert within_bounds(plain)
    assert decode(type(good), asdict(value)) == value


@pytest.mark.parametrize("good", HEADERS, ids=lambda good: type(good).__name__)
@given(data=st.data())
def test_a_header_becomes_a_bounded_value_or_is_refused(good: Any, data: st.DataObject) -> None:
    received = {**asdict(good), **data.draw(changes(asdict(good)))}
    try:
        header = decode_header(type(good), pack(received))
    except ValueError:
        return
    for name, field in asdict(header).items():
        assert type(field) is type(asdict(good)[name]), name
        assert not isinstance(field, int) or 0 <= field <= MAX_COUNT


@given(question=VALUES | changes([*asdict(Question("i")), "more"]))
@example({"file": [1]})
@example({"job": False, "result": {}})
def test_an_evaluator_answers_whatever_it_is_asked_and_ends_well(question: Any) -> None:
    def read(job: int, received: dict[str, Any]) -> str:
        if received != {"is": "good"}:
            raise ValueError(f"result: got {received!r:.40}")
        return "good"

    hub = MemoryHub()
    server = WorkServer(hub.connect(), "r", [{}], {"f": b"x"}, read)
    whole = {"wire": WIRE_VERSION, **asdict(Question("i")), **question} if isinstance(question, dict) else question
    answer = hub.connect().get(keys.work("r", "bad"), pack(whole), timeout_s=5.0)
    assert answer is not None
    decode_message(Answer, answer.payload, 1 << 20)
    given_to_bad = hub.connect().announce(keys.alive("r", "actor", "bad", "i"))
    given_to_bad.close()  # what it was handed goes to others
    client = WorkClient(hub.connect(), "r", "good", lambda: False, away_s=5.0)
    work = client.next()
    assert work is not None
    assert client.next((work, {"is": "good"})) is None
    assert list(server.results()) == [(0, "good")]


def test_the_status_of_as_many_actors_as_can_connect_fits() -> None:
    longest = ActorStatus("a" * 64, 1e15 / 3, MAX_COUNT, MAX_COUNT, 10**7, 1e11 / 3, "\U0001f600" * MAX_TEXT)
    status = asdict(STATUS) | {"actors": [asdict(longest)] * MAX_CONNECTIONS}
    hub = MemoryHub()
    ControlServer(hub.connect(), "run", "{}", status=lambda: status)
    assert len(fetch_run_status(hub.connect(), "run").actors) == MAX_CONNECTIONS
    assert len(pack(status)) < MAX_STATUS_BYTES


def test_messages_survive_their_encoding() -> None:
    for message in (Question("i", job=3, result={"a": [1.5]}), Answer(file=b"x"), Answer(job=1, what={"n": 1})):
        assert decode_message(type(message), encode(message), 1 << 20) == message
