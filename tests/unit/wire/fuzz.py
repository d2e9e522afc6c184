"""A hostile client for the fuzz test: python -m tests.unit.wire.fuzz ENDPOINT COUNT SEED NAME

Sends COUNT messages that cannot be accepted, of every kind, many at a time, each again until it has been judged, and
prints how many of each kind. The same names, run and key as a good actor's are among them.
"""

from __future__ import annotations

import json
import queue
import random
import struct
import sys
import threading
import time
import zlib
from collections import Counter
from dataclasses import asdict, replace
from typing import Any

import numpy as np
import zenoh

from appl_dist.spec import Rollout
from appl_dist.wire import key_expressions as keys
from appl_dist.wire.codec import (
    MAX_ROLLOUT_BYTES,
    Ack,
    UploadHeader,
    decode_header,
    encode_header,
    encode_rollout,
    pack,
)
from appl_dist.wire.session import Session, open_session
from appl_dist.wire.wire_settings import WireSettings
from tests.unit.wire.support import make_rollout

IN_FLIGHT = 48  # with two of us, fewer than the learner lets strangers queue: all are read
NAMES = 64
GOOD: Rollout = make_rollout(0)
BLOB = encode_rollout(GOOD)
HEADER = UploadHeader("run1", "bad-0", "i", 0, 0, len(GOOD))


def sealed(body: bytes) -> bytes:
    """`body` (layout length onwards) with the checksum it should have."""
    return struct.pack("<I", zlib.crc32(body)) + body


def with_layout(**changes: Any) -> bytes:
    layout = {
        "transitions": len(GOOD), "observation_size": 729, "scan_size": 720, "action_size": 8,
        "terminal": False, "info": {}, **changes,
    }  # fmt: skip
    packed = pack(layout)
    _, length = struct.unpack_from("<II", BLOB)
    return sealed(struct.pack("<I", len(packed)) + packed + BLOB[8 + length :])


def not_finite(rng: random.Random) -> bytes:
    """A rollout whose last reward, or an action, is no number: checksum, sizes and layout are right."""
    value = struct.pack("<f", rng.choice([np.nan, np.inf, -np.inf]))
    at = len(BLOB) - 4 * rng.randrange(1, 9)
    return sealed(BLOB[4:at] + value + BLOB[at + 4 :])


def message(kind: str, rng: random.Random) -> tuple[str, bytes, bytes]:
    """(key, payload, attachment)"""
    name = f"bad-{rng.randrange(NAMES)}"
    mine = replace(HEADER, actor=name)
    key, header, blob = keys.upload("run1", name), encode_header(mine), BLOB
    if kind == "malformed":
        parts = [bytearray(header), bytearray(blob)]
        for part in parts:
            for _ in range(rng.randrange(1, 8)):
                part[rng.randrange(len(part))] ^= rng.randrange(1, 256)
        header, blob = map(bytes, parts)
    elif kind == "truncated":
        blob = blob[: rng.randrange(len(blob))]
    elif kind == "oversized":
        blob = bytes(MAX_ROLLOUT_BYTES + rng.choice([1, 1 << 20]))
    elif kind == "wrong shape":
        field = rng.choice(["transitions", "observation_size", "action_size", "info", "terminal"])
        blob = with_layout(**{field: rng.choice([0, -1, 2, 4, 10**9, "x", None, [1], 1.5])})
    elif kind == "not finite":
        blob = not_finite(rng)
    elif kind == "replayed":  # under the good actor's name, with a number it has long had
        key, header = keys.upload("run1", "a0"), encode_header(replace(HEADER, actor="a0"))
    elif kind == "other run":
        key, header = keys.upload("run2", name), encode_header(replace(mine, run="run2"))
    elif kind == "other version":
        header = pack({**asdict(mine), "wire": rng.randrange(2, 99)})
    elif kind == "other key":
        key = keys.upload(rng.choice(["run1", "run2"]), rng.choice(["worse", "x" * 200]))
    elif kind == "noise":
        header, blob = rng.randbytes(rng.randrange(200)), rng.randbytes(rng.randrange(200))
    return key, blob, header


KINDS = {
    "malformed": 30, "truncated": 10, "oversized": 0.02, "wrong shape": 10, "not finite": 10, "replayed": 10,
    "other run": 5, "other version": 5, "other key": 5, "noise": 10,
}  # fmt: skip


def main() -> None:
    endpoint, count, seed = sys.argv[1], int(sys.argv[2]), int(sys.argv[3])
    rng = random.Random(seed)
    sent: Counter[str] = Counter()
    free = threading.Semaphore(IN_FLIGHT)
    turned_away: queue.SimpleQueue[tuple[str, bytes, bytes]] = queue.SimpleQueue()

    def send(session: Session, key: str, payload: bytes, attachment: bytes) -> None:
        def judged(reply: zenoh.Reply) -> None:
            if reply.ok is not None and decode_header(Ack, reply.ok.payload.to_bytes()).status == "busy":
                turned_away.put((key, payload, attachment))

        free.acquire()
        session._session.get(
            key,
            zenoh.handlers.Callback(judged, free.release),
            payload=payload,
            attachment=attachment,
            timeout=30.0,
            congestion_control=zenoh.CongestionControl.BLOCK,
        )

    with open_session(WireSettings(endpoint, timeout_s=30.0), listen=False) as session:
        for _ in range(count):
            kind = rng.choices(list(KINDS), list(KINDS.values()))[0]
            send(session, *message(kind, rng))
            sent[kind] += 1
            if rng.random() < 0.1:
                session.put(keys.progress("run1", "actor", "bad"), rng.randbytes(rng.randrange(100)))
        while True:
            for _ in range(IN_FLIGHT):
                free.acquire()
            if turned_away.empty():
                break
            free.release(IN_FLIGHT)
            time.sleep(0.05)
            for _ in range(turned_away.qsize()):
                send(session, *turned_away.get())
    print(json.dumps(sent))


if __name__ == "__main__":
    main()
