"""Bytes of the wire: msgpack headers, raw little-endian arrays, and the checks on both.

A rollout is one self-contained blob, the same in the spool file and on the wire:

    4 bytes   CRC-32 of everything after it
    4 bytes   length of the layout
    layout    msgpack map: transitions, observation_size, scan_size, action_size, terminal, info
    arrays    scan (n + 1, scan_size) uint16 | rest of the observation (n + 1, observation_size - scan_size) float32
              | actions (n, a) float32 | rewards (n,) float32

The scan travels in fixed point, 0..65535 for -1..1, so 50 transitions take 77 KB instead of 150 KB. Scaled
ranges span 2 m, so rounding moves a beam by at most 2^-16 or 0.016 mm of range (float16 of the same size:
0.24 mm). Decoding and encoding again gives the same bytes, so a replay that keeps uint16 loses nothing more.
Everything else is float32, bit for bit.

Nothing received is trusted: sizes are checked against the layout before any array exists, then dtype, shape,
range and finiteness. Every failure is a ValueError whose text can be sent back.
"""

from __future__ import annotations

import struct
import zlib
from dataclasses import asdict, dataclass, fields
from typing import Any, NamedTuple, TypeVar

import msgpack
import numpy as np

from appl_dist.spec import WIRE_VERSION, Rollout
from appl_dist.wire.key_expressions import is_name

MAX_TRANSITIONS = 4096
MAX_ACTION_SIZE = 64
MAX_OBSERVATION_SIZE = 65_536
MAX_LAYOUT_BYTES = 64 << 10
MAX_ROLLOUT_BYTES = 16 << 20
MAX_HEADER_BYTES = 4 << 10
MAX_COUNT = 2**53  # sequence numbers, epochs and versions; exact in any language

_SCAN_SCALE = 65535 / 2
_PREFIX = struct.Struct("<II")


class Sizes(NamedTuple):
    """How many transitions a rollout holds, and of how many entries: observation, scan within it, action."""

    transitions: int
    observation: int
    scan: int
    action: int

    def array_bytes(self) -> tuple[int, int, int, int]:
        """Bytes of scan, rest of the observation, actions and rewards."""
        n = self.transitions
        rest = self.observation - self.scan
        return (n + 1) * self.scan * 2, (n + 1) * rest * 4, n * self.action * 4, n * 4


def pack(value: Any) -> bytes:
    """msgpack bytes of plain values; numpy scalars become Python numbers. ValueError for anything else."""
    try:
        return bytes(msgpack.packb(value, default=_plain))
    except (TypeError, OverflowError, ValueError) as error:
        raise ValueError(f"not plain msgpack values: {error}") from error


def _plain(value: Any) -> Any:
    if isinstance(value, np.generic):
        return value.item()
    raise TypeError(f"{type(value).__name__} {value!r}")


def unpack_map(data: bytes, limit: int) -> dict[str, Any]:
    """The msgpack map in `data`: string keys, plain values, at most `limit` bytes; else ValueError."""
    if len(data) > limit:
        raise ValueError(f"map of {len(data)} bytes; allowed up to {limit}")
    try:
        value = msgpack.unpackb(data, raw=False, strict_map_key=True, ext_hook=_no_extension, timestamp=0)
    except Exception as error:  # msgpack raises many kinds, RecursionError and its own StackError among them
        raise ValueError(f"not msgpack: {type(error).__name__}") from error
    if not isinstance(value, dict) or not all(isinstance(key, str) for key in value):
        raise ValueError(f"not a map with string keys: {type(value).__name__}")
    return value


def _no_extension(code: int, data: bytes) -> Any:
    raise ValueError(f"extension type {code}")


def encode_rollout(rollout: Rollout) -> bytes:
    """The blob of `rollout`; ValueError if it is not one this codec would accept back."""
    rollout.check()
    n = len(rollout)
    if n > MAX_TRANSITIONS or rollout.actions.shape[1] > MAX_ACTION_SIZE:
        raise ValueError(
            f"actions: got shape {rollout.actions.shape}; allowed up to ({MAX_TRANSITIONS}, {MAX_ACTION_SIZE})"
        )
    size, scan_size = rollout.observations.shape[1], rollout.scan_size
    if size > MAX_OBSERVATION_SIZE:
        raise ValueError(f"observations: got {size} entries; allowed up to {MAX_OBSERVATION_SIZE}")
    scan = rollout.observations[:, :scan_size]
    if np.abs(scan).max(initial=0.0) > 1.0 + 1e-5:  # what is within rounding of 1 becomes 1
        raise ValueError(f"observations: scaled range of {np.abs(scan).max():g}; allowed -1..1")
    layout = pack(
        {
            "transitions": n,
            "observation_size": size,
            "scan_size": scan_size,
            "action_size": rollout.actions.shape[1],
            "terminal": bool(rollout.terminal),
            "info": rollout.info,
        }
    )
    if len(layout) > MAX_LAYOUT_BYTES:
        raise ValueError(f"info: takes {len(layout)} bytes; allowed up to {MAX_LAYOUT_BYTES}")
    body = b"".join(
        (
            layout,
            (scan * _SCAN_SCALE + (_SCAN_SCALE + 0.5)).astype("<u2").tobytes(),  # truncates to the nearest
            rollout.observations[:, scan_size:].astype("<f4").tobytes(),
            rollout.actions.astype("<f4").tobytes(),
            rollout.rewards.astype("<f4").tobytes(),
        )
    )
    length = struct.pack("<I", len(layout))
    return b"".join((struct.pack("<I", zlib.crc32(body, zlib.crc32(length))), length, body))


def decode_rollout(blob: bytes) -> Rollout:
    """The rollout in `blob`, every field checked; ValueError naming the first that cannot be."""
    if not is_intact(blob):
        raise ValueError("rollout: checksum does not match; the bytes are damaged or not a rollout")
    _, length = _PREFIX.unpack_from(blob)
    if length > MAX_LAYOUT_BYTES or _PREFIX.size + length > len(blob):
        raise ValueError(f"layout: got {length} bytes; allowed up to {MAX_LAYOUT_BYTES}, inside the blob")
    offset = _PREFIX.size + length
    layout = unpack_map(blob[_PREFIX.size : offset], MAX_LAYOUT_BYTES)
    sizes = _layout_sizes(layout)
    n, size, scan_size, action_size = sizes
    if offset + sum(sizes.array_bytes()) != len(blob):
        raise ValueError(f"arrays: got {len(blob) - offset} bytes; {n} transitions take {sum(sizes.array_bytes())}")

    def take(dtype: str, count: int, *shape: int) -> np.ndarray:
        nonlocal offset
        array = np.frombuffer(blob, dtype, count, offset)
        offset += array.nbytes
        return array.reshape(shape)

    observations = np.empty((n + 1, size), np.float32)
    scan = take("<u2", (n + 1) * scan_size, n + 1, scan_size)
    # A division, so that both ends are exactly -1 and 1.
    np.subtract(scan / np.float32(_SCAN_SCALE), 1.0, out=observations[:, :scan_size], dtype=np.float32)
    observations[:, scan_size:] = take("<f4", (n + 1) * (size - scan_size), n + 1, size - scan_size)
    actions = take("<f4", n * action_size, n, action_size).astype(np.float32)
    rewards = take("<f4", n, n).astype(np.float32)
    rollout = Rollout(observations, actions, rewards, layout["terminal"], layout["info"], scan_size)
    rollout.check()
    return rollout


def sizes_in(blob: bytes) -> Sizes:
    """The sizes that the blob says it has; ValueError if it is not a rollout."""
    if len(blob) < _PREFIX.size:
        raise ValueError(f"rollout: got {len(blob)} bytes")
    _, length = _PREFIX.unpack_from(blob)
    return _layout_sizes(unpack_map(blob[_PREFIX.size : _PREFIX.size + length], MAX_LAYOUT_BYTES))


def is_intact(blob: bytes) -> bool:
    """Whether the checksum holds: false for a torn or damaged blob."""
    if not _PREFIX.size < len(blob) <= MAX_ROLLOUT_BYTES:
        return False
    return bool(zlib.crc32(memoryview(blob)[4:]) == struct.unpack_from("<I", blob)[0])


def _layout_sizes(layout: dict[str, Any]) -> Sizes:
    """The sizes in a layout map whose fields are all there and of the right kind."""
    wanted = {"transitions", "observation_size", "scan_size", "action_size", "terminal", "info"}
    if set(layout) != wanted:
        raise ValueError(f"layout: got fields {sorted(layout)[:8]}; expected {sorted(wanted)}")
    n, size, scan, actions = (layout[k] for k in ("transitions", "observation_size", "scan_size", "action_size"))
    if type(n) is not int or not 1 <= n <= MAX_TRANSITIONS:
        raise ValueError(f"transitions: got {n!r:.40}; allowed 1..{MAX_TRANSITIONS}")
    if type(size) is not int or not 1 <= size <= MAX_OBSERVATION_SIZE:
        raise ValueError(f"observation_size: got {size!r:.40}; allowed 1..{MAX_OBSERVATION_SIZE}")
    if type(scan) is not int or not 0 <= scan <= size:
        raise ValueError(f"scan_size: got {scan!r:.40}; allowed 0..{size}")
    if type(actions) is not int or not 1 <= actions <= MAX_ACTION_SIZE:
        raise ValueError(f"action_size: got {actions!r:.40}; allowed 1..{MAX_ACTION_SIZE}")
    if type(layout["terminal"]) is not bool or not isinstance(layout["info"], dict):
        raise ValueError("terminal, info: expected a bool and a map")
    if not all(isinstance(key, str) for key in layout["info"]):
        raise ValueError("info: expected string keys")
    return Sizes(n, size, scan, actions)


@dataclass(frozen=True)
class UploadHeader:
    """Who sends what: attachment of an upload. `hello` asks for the next sequence number and sends nothing.

    `incarnation` names the sending process, `epoch` the learner process it last said hello to, `seq` the
    rollout (0, 1, 2, … for each actor; in a hello the oldest not yet acked), `count` its transitions.
    """

    run: str
    actor: str
    incarnation: str
    epoch: int
    seq: int
    count: int
    hello: bool = False
    wire: int = WIRE_VERSION

    def __post_init__(self) -> None:
        for name in ("run", "actor", "incarnation"):
            if not is_name(getattr(self, name)):
                raise ValueError(f"{name}: got {getattr(self, name)!r:.80}; not a name")
        _check_counts(self, ("epoch", "seq"), MAX_COUNT)
        _check_counts(self, ("count",), MAX_TRANSITIONS)
        if type(self.hello) is not bool or self.hello != (self.count == 0):
            raise ValueError(f"hello: got {self.hello!r:.40} with {self.count} transitions")


STATUSES = ("welcome", "stored", "duplicate", "busy", "hello", "refused")


@dataclass(frozen=True)
class Ack:
    """The learner's answer to an upload.

    welcome: the hello is accepted. stored: durable in replay. duplicate: it was already. busy: ask again
    after `retry_s`. hello: say hello first. refused: never will be; `reason` says why. `expected` is the
    actor's next sequence number.
    """

    status: str
    expected: int = 0
    retry_s: float = 0.0
    reason: str = ""
    epoch: int = 0
    wire: int = WIRE_VERSION

    def __post_init__(self) -> None:
        if self.status not in STATUSES:
            raise ValueError(f"status: got {self.status!r:.40}; allowed {', '.join(STATUSES)}")
        _check_counts(self, ("expected", "epoch"), MAX_COUNT)
        if type(self.retry_s) is not float or not 0.0 <= self.retry_s <= 60.0:
            raise ValueError(f"retry_s: got {self.retry_s!r:.40}; allowed 0..60")
        if not isinstance(self.reason, str):
            raise ValueError("reason: expected a string")


@dataclass(frozen=True)
class WeightsHeader:
    """Attachment of a policy: newer is larger (epoch, version). `size` is the blob's, in bytes."""

    run: str
    epoch: int
    version: int
    size: int
    wire: int = WIRE_VERSION

    def __post_init__(self) -> None:
        if not is_name(self.run):
            raise ValueError(f"run: got {self.run!r:.80}; not a name")
        _check_counts(self, ("epoch", "version", "size"), MAX_COUNT)


@dataclass(frozen=True)
class StateHeader:
    """The desired state of every actor as a versioned value: the larger (epoch, version) holds."""

    run: str
    epoch: int
    version: int
    state: str
    wire: int = WIRE_VERSION

    def __post_init__(self) -> None:
        if not is_name(self.run) or self.state not in ("run", "stop"):
            raise ValueError(f"state: got {self.state!r:.40} of run {self.run!r:.80}; allowed run, stop")
        _check_counts(self, ("epoch", "version"), MAX_COUNT)


def _check_counts(header: Any, names: tuple[str, ...], limit: int) -> None:
    for name in names:
        value = getattr(header, name)
        if type(value) is not int or not 0 <= value <= limit:
            raise ValueError(f"{name}: got {value!r:.40}; allowed 0..{limit}")


Header = TypeVar("Header", UploadHeader, Ack, WeightsHeader, StateHeader)


def encode_header(header: UploadHeader | Ack | WeightsHeader | StateHeader) -> bytes:
    return pack(asdict(header))


def decode_header(kind: type[Header], data: bytes) -> Header:
    """The header of `kind` in `data`. The wire version is judged first: other fields may have changed."""
    values = unpack_map(data, MAX_HEADER_BYTES)
    if values.get("wire") != WIRE_VERSION:
        raise ValueError(
            f"wire version: got {values.get('wire')!r:.40}, this side speaks {WIRE_VERSION}; "
            "run the same appl-dist version everywhere"
        )
    names = {field.name for field in fields(kind)}
    if set(values) != names:
        raise ValueError(f"header: got fields {sorted(values)[:8]}; expected {sorted(names)}")
    return kind(**values)
