"""Whatever arrives as a policy, it is either refused in a sentence or a policy that can act."""

from __future__ import annotations

import json
import struct
from typing import Any

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from appl_dist.errors import UserError
from appl_dist.planner.dwa import DWA
from appl_dist.policy.load import policy_from_file
from appl_dist.policy_file import PolicyFile
from tests.paper_sizes import LAYOUT, OBSERVATION_SIZE

BLOB = PolicyFile(
    (np.zeros((8, OBSERVATION_SIZE), np.float32),), (np.zeros(8, np.float32),), space=DWA, observation=LAYOUT
).to_bytes()
HEADER = 8 + struct.unpack("<Q", BLOB[:8])[0]


def refused_or_acts(blob: bytes) -> None:
    try:
        found = PolicyFile.from_bytes(blob)
    except UserError:
        return
    assert found.to_bytes()
    layout = found.observation or LAYOUT
    action = policy_from_file(found, found.space, "x", layout).act(np.zeros(layout.size, np.float32))
    assert action.shape == (len(found.space),)
    assert (np.abs(action) <= 1).all()


@settings(max_examples=300, deadline=None)
@given(
    st.lists(st.tuples(st.integers(0, HEADER + 200), st.integers(0, 255)), min_size=1, max_size=4),
    st.integers(0, len(BLOB)),
)
def test_flipped_bytes_and_cuts(changes: list[tuple[int, int]], cut: int) -> None:
    blob = bytearray(BLOB)
    for at, value in changes:
        blob[at] = value
    refused_or_acts(bytes(blob))
    refused_or_acts(bytes(blob[:cut]))


values = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=5) | st.just(10**400),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=5), inner, max_size=3),
    max_leaves=4,
)


@settings(max_examples=300, deadline=None)
@given(st.data(), values)
def test_any_value_in_any_place_of_the_header(data: st.DataObject, value: Any) -> None:
    outer = json.loads(BLOB[8:HEADER])
    header = json.loads(outer["__metadata__"]["appl_policy"])
    place: Any = header
    while True:
        key = data.draw(st.sampled_from(sorted(place) if isinstance(place, dict) else range(len(place))))
        if not isinstance(place[key], (dict, list)) or not place[key] or data.draw(st.booleans()):
            break
        place = place[key]
    place[key] = value
    outer["__metadata__"]["appl_policy"] = json.dumps(header)
    text = json.dumps(outer).encode()
    text += b" " * (-len(text) % 8)
    refused_or_acts(struct.pack("<Q", len(text)) + text + BLOB[HEADER:])


def test_deep_nesting_is_refused() -> None:
    text = b"[" * 100_000
    refused_or_acts(struct.pack("<Q", len(text)) + text)


def test_the_untouched_blob_acts() -> None:
    assert (
        policy_from_file(PolicyFile.from_bytes(BLOB), DWA, "x", LAYOUT)
        .act(np.zeros(OBSERVATION_SIZE, np.float32))
        .tolist()
        == [0] * 8
    )
