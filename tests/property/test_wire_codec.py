"""Any rollout returns as it was; any other bytes are a ValueError, quickly and without large allocations."""

import tracemalloc

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from appl_dist.spec import Rollout
from appl_dist.wire.codec import (
    Ack,
    StateHeader,
    UploadHeader,
    WeightsHeader,
    decode_header,
    decode_rollout,
    encode_header,
    encode_rollout,
)
from tests.paper_sizes import LIDAR_BEAMS, OBSERVATION_SIZE
from tests.unit.wire.support import make_rollout

unit = st.floats(-1, 1, width=32)
plain = st.none() | st.booleans() | st.integers(-(2**63), 2**64 - 1) | st.floats() | st.text(max_size=20)


@st.composite
def rollouts(draw):
    n = draw(st.integers(1, 5))
    return Rollout(
        draw(arrays(np.float32, (n + 1, OBSERVATION_SIZE), elements=unit, fill=unit)),
        draw(arrays(np.float32, (n, draw(st.integers(1, 12))), elements=unit)),
        draw(arrays(np.float32, n, elements=st.floats(-(2.0**100), 2.0**100, width=32))),
        draw(st.booleans()),
        draw(st.dictionaries(st.text(max_size=10), plain | st.lists(plain, max_size=3), max_size=5)),
        LIDAR_BEAMS,
    )


@given(rollouts())
@settings(max_examples=60, deadline=None)
def test_a_rollout_returns_with_only_its_scan_rounded(rollout):
    got = decode_rollout(encode_rollout(rollout))
    np.testing.assert_array_equal(got.observations[:, LIDAR_BEAMS:], rollout.observations[:, LIDAR_BEAMS:])
    np.testing.assert_allclose(
        got.observations[:, :LIDAR_BEAMS], rollout.observations[:, :LIDAR_BEAMS], rtol=0, atol=2**-16 * 1.02
    )
    np.testing.assert_array_equal(got.actions, rollout.actions)
    np.testing.assert_array_equal(got.rewards, rollout.rewards)
    assert got.terminal == rollout.terminal
    assert repr(got.info) == repr(rollout.info)  # repr, since nan differs from itself
    np.testing.assert_array_equal(decode_rollout(encode_rollout(got)).observations, got.observations)


@given(st.binary(max_size=300))
@settings(max_examples=300, deadline=None)
def test_arbitrary_bytes_are_a_value_error(data):
    for read in (decode_rollout, *(lambda d, k=k: decode_header(k, d) for k in KINDS)):
        with pytest.raises(ValueError, match=r"expected|wire version|not msgpack|not a map|checksum"):
            read(data)


KINDS = (UploadHeader, Ack, WeightsHeader, StateHeader)
HEADERS = (
    UploadHeader("run1", "a0", "0f", 2, 7, 50),
    Ack("busy", 3, 0.25, "later", 2),
    WeightsHeader("run1", 1, 2, 3),
    StateHeader("run1", 1, 2, "stop"),
)


@given(st.data())
@settings(max_examples=300, deadline=None)
def test_a_changed_header_is_a_header_or_a_value_error(data):
    header = data.draw(st.sampled_from(HEADERS))
    damaged = bytearray(encode_header(header))
    for _ in range(data.draw(st.integers(1, 4))):
        damaged[data.draw(st.integers(0, len(damaged) - 1))] = data.draw(st.integers(0, 255))
    try:
        got = decode_header(type(header), bytes(damaged))
    except ValueError:
        return
    assert isinstance(got, type(header))  # and its own checks have run


@given(st.integers(0, 10**9), st.integers(0, 255))
@settings(max_examples=200, deadline=None)
def test_no_flipped_byte_of_a_rollout_passes(position, value):
    blob = bytearray(BLOB)
    position %= len(blob)
    if blob[position] == value:
        return
    blob[position] = value
    with pytest.raises(ValueError, match="checksum"):
        decode_rollout(bytes(blob))


BLOB = encode_rollout(make_rollout(3))


@given(st.integers(1, 2**63), st.integers(1, 2**63))
@settings(max_examples=50, deadline=None)
def test_claimed_sizes_allocate_nothing(transitions, action_size):
    from tests.unit.wire.test_codec import forge, layout_of

    blob = forge(layout_of(transitions, action_size=action_size), bytes(3000))
    tracemalloc.start()
    try:
        with pytest.raises(ValueError, match="got"):
            decode_rollout(blob)
        assert tracemalloc.get_traced_memory()[1] < 100_000
    finally:
        tracemalloc.stop()
