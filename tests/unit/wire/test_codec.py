import struct
import zlib
from dataclasses import asdict, replace

import msgpack
import numpy as np
import pytest

from appl_dist.spec import WIRE_VERSION, Rollout
from appl_dist.wire.codec import (
    MAX_LAYOUT_BYTES,
    Ack,
    StateHeader,
    UploadHeader,
    WeightsHeader,
    decode_header,
    decode_rollout,
    encode_header,
    encode_rollout,
    pack,
    sizes_in,
)
from tests.paper_sizes import LIDAR_BEAMS
from tests.unit.wire.support import make_rollout


def forge(layout: object, arrays: bytes) -> bytes:
    """A blob with a right checksum around whatever is given."""
    packed = layout if isinstance(layout, bytes) else msgpack.packb(layout)
    body = struct.pack("<I", len(packed)) + packed + arrays
    return struct.pack("<I", zlib.crc32(body)) + body


def layout_of(transitions: object = 1, **changes: object) -> dict[str, object]:
    sizes = {"transitions": transitions, "observation_size": 729, "scan_size": 720, "action_size": 8}
    return {**sizes, "terminal": True, "info": {}, **changes}


def arrays_of(n: int, action_size: int = 8) -> bytes:
    return bytes((n + 1) * (720 * 2 + 9 * 4) + n * (action_size + 1) * 4)


def arrays_with(offset: int, value: float) -> bytes:
    """Arrays of one transition, zero but for one float32: the rest of the observation begins at 2880 bytes,
    the actions at 2952, the reward at 2984."""
    arrays = bytearray(arrays_of(1))
    struct.pack_into("<f", arrays, offset, value)
    return bytes(arrays)


def test_everything_but_the_scan_returns_bit_for_bit():
    rollout = make_rollout(5, transitions=7)
    got = decode_rollout(encode_rollout(rollout))
    np.testing.assert_array_equal(got.observations[:, LIDAR_BEAMS:], rollout.observations[:, LIDAR_BEAMS:])
    np.testing.assert_array_equal(got.actions, rollout.actions)
    np.testing.assert_array_equal(got.rewards, rollout.rewards)
    assert (got.terminal, got.info) == (rollout.terminal, rollout.info)


def test_the_scan_moves_by_at_most_half_a_step():
    rollout = make_rollout(1, transitions=40)
    error = decode_rollout(encode_rollout(rollout)).observations - rollout.observations
    assert 1e-6 < np.abs(error).max() <= 2.0**-16 * 1.02  # scaled units, 1 m each; float32 rounds too


def test_the_ends_of_the_scan_and_every_step_between_are_kept_exactly():
    levels = np.arange(65536, dtype=np.float64)
    scan = (levels / 32767.5 - 1.0).astype(np.float32)
    observations = np.zeros((92, 729), np.float32)
    observations[:, :LIDAR_BEAMS].flat = np.resize(scan, 92 * 720)
    observations[0, :3] = (-1.0, 1.0, 1.0 + 1e-6)
    actions, rewards = np.zeros((91, 8), np.float32), np.zeros(91, np.float32)
    got = decode_rollout(encode_rollout(Rollout(observations, actions, rewards, True, {}, LIDAR_BEAMS))).observations
    assert got[0, :3].tolist() == [-1.0, 1.0, 1.0]
    assert np.abs(got).max() <= 1.0
    steps = np.rint((got[1:, :LIDAR_BEAMS].astype(np.float64) + 1.0) * 32767.5)
    np.testing.assert_array_equal(steps.ravel(), np.resize(levels, 92 * 720)[720:])


def test_a_decoded_rollout_encodes_to_the_same_bytes():
    blob = encode_rollout(make_rollout(2))
    assert encode_rollout(decode_rollout(blob)) == blob


def test_numpy_scalars_in_info_become_plain_numbers():
    rollout = replace(make_rollout(0), info={"seed": np.int64(3), "time_s": np.float32(0.5), "success": np.True_})
    assert decode_rollout(encode_rollout(rollout)).info == {"seed": 3, "time_s": 0.5, "success": True}


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"info": {"world": object()}}, "not plain msgpack"),
        ({"info": {"text": "x" * MAX_LAYOUT_BYTES}}, "info: takes"),
        ({"rewards": np.array([1, np.nan, 0], np.float32)}, "rewards: holds a value that is not finite"),
        ({"rewards": np.zeros(3)}, "rewards: got float64"),
        ({"observations": np.full((4, 729), 1.5, np.float32)}, "scaled range of 1.5"),
        ({"actions": np.full((3, 8), 1.5, np.float32)}, "actions: got 1.5"),
        ({"actions": np.zeros((3, 65), np.float32)}, "allowed up to"),
    ],
)
def test_a_rollout_that_could_not_be_read_back_is_not_written(change, message):
    with pytest.raises(ValueError, match=message):
        encode_rollout(replace(make_rollout(0), **change))


@pytest.mark.parametrize(
    ("blob", "message"),
    [
        (b"", "checksum"),
        (b"\0" * 100, "checksum"),
        (encode_rollout(make_rollout(0))[:-1], "checksum"),
        (forge(layout_of(), arrays_of(1)[:-4]), "arrays: got"),
        (forge(layout_of(), arrays_of(1) + b"\0"), "arrays: got"),
        (forge(layout_of(4096), arrays_of(1)), "arrays: got"),
        (forge(layout_of(2**40), arrays_of(1)), "transitions: got"),
        (forge(layout_of(0), arrays_of(0)), "transitions: got 0"),
        (forge(layout_of(-1), arrays_of(1)), "transitions: got -1"),
        (forge(layout_of(True), arrays_of(1)), "transitions: got True"),
        (forge(layout_of(1.0), arrays_of(1)), "transitions: got 1.0"),
        (forge(layout_of(observation_size=728), arrays_of(1)), "arrays: got"),
        (forge(layout_of(observation_size=0), arrays_of(1)), "observation_size: got 0"),
        (forge(layout_of(observation_size=10**9), arrays_of(1)), "observation_size: got 1000000000"),
        (forge(layout_of(scan_size=730), arrays_of(1)), r"scan_size: got 730; allowed 0\.\.729"),
        (forge(layout_of(scan_size=True), arrays_of(1)), "scan_size: got True"),
        (forge(layout_of(action_size=2**31), arrays_of(1)), "action_size"),
        (forge(layout_of(terminal=1), arrays_of(1)), "terminal"),
        (forge(layout_of(info=[]), arrays_of(1)), "info"),
        (forge(layout_of(info={1: 2}), arrays_of(1)), "not msgpack"),
        (forge(layout_of(extra=1), arrays_of(1)), "layout: got fields"),
        (forge({}, arrays_of(1)), "layout: got fields"),
        (forge([1, 2], arrays_of(1)), "not a map"),
        (forge(b"\xc1", arrays_of(1)), "not msgpack"),
        (forge(b"\xdf\xff\xff\xff\xff", arrays_of(1)), "not msgpack"),
        (forge(b"\x91" * 60000, arrays_of(1)), "not msgpack"),
        (forge(layout_of(info={"t": msgpack.ExtType(5, b"x")}), arrays_of(1)), "not msgpack"),
        (forge(layout_of(), arrays_with(2984, np.inf)), "rewards: holds"),
        (forge(layout_of(), arrays_with(2880, np.nan)), "observations: holds"),
        (forge(layout_of(), arrays_with(2952, 1.5)), "actions: got 1.5"),
        (forge(layout_of(), arrays_with(2952, -np.inf)), "actions: holds"),
    ],
)
def test_bad_bytes_are_refused_with_the_field(blob, message):
    with pytest.raises(ValueError, match=message):
        decode_rollout(blob)


def test_the_forged_layout_itself_is_readable():
    """Guards the table above: each case must fail for its own reason only."""
    assert len(decode_rollout(forge(layout_of(), arrays_of(1)))) == 1


def test_the_length_of_the_layout_is_bounded_before_it_is_read():
    body = struct.pack("<I", 2**32 - 1) + bytes(100)
    with pytest.raises(ValueError, match="layout: got 4294967295 bytes"):
        decode_rollout(struct.pack("<I", zlib.crc32(body)) + body)


def test_transitions_are_known_without_decoding():
    assert sizes_in(encode_rollout(make_rollout(0, transitions=11))) == (11, 729, 720, 8)


HEADERS = [
    UploadHeader("run1", "a0", "0f", 2, 7, 50),
    UploadHeader("run1", "a0", "0f", 2, 7, 0, hello=True),
    Ack("busy", 3, 0.25, "later", 2),
    WeightsHeader("run1", 1, 2, 3),
    StateHeader("run1", 1, 2, "stop"),
]


@pytest.mark.parametrize("header", HEADERS)
def test_headers_return_as_they_were(header):
    assert decode_header(type(header), encode_header(header)) == header


@pytest.mark.parametrize("header", HEADERS)
def test_another_wire_version_is_refused_by_name(header):
    other = pack({**asdict(header), "wire": WIRE_VERSION + 1, "more": 1})
    with pytest.raises(ValueError, match=f"wire version: got {WIRE_VERSION + 1}, this side speaks {WIRE_VERSION}"):
        decode_header(type(header), other)


@pytest.mark.parametrize(
    ("field", "value"),
    [
        ("run", "a/b"), ("run", ""), ("run", 3), ("actor", "*"), ("actor", "x" * 65), ("incarnation", None),
        ("epoch", -1), ("seq", 1.5), ("seq", True), ("seq", 2**60), ("count", 10**6), ("count", "9"),
        ("hello", 1), ("hello", True),
    ],
)  # fmt: skip
def test_an_upload_header_with_a_wrong_field_is_refused(field, value):
    values = {**asdict(HEADERS[0]), field: value}
    with pytest.raises(ValueError, match=field):
        decode_header(UploadHeader, pack(values))


@pytest.mark.parametrize(("field", "value"), [("status", "ok"), ("retry_s", 1e9), ("retry_s", "1"), ("reason", 1)])
def test_an_ack_with_a_wrong_field_is_refused(field, value):
    with pytest.raises(ValueError, match=field):
        decode_header(Ack, pack({**asdict(HEADERS[2]), field: value}))


def test_a_header_with_a_missing_or_unknown_field_is_refused():
    values = asdict(HEADERS[0])
    del values["seq"]
    with pytest.raises(ValueError, match="expected"):
        decode_header(UploadHeader, pack(values))
    with pytest.raises(ValueError, match="expected"):
        decode_header(UploadHeader, pack({**asdict(HEADERS[0]), "x": 1}))
