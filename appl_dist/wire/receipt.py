"""What identifies a rollout on both sides of the wire: how many transitions, and a digest of their exact bytes.

The digest covers what replay keeps bit for bit: the observations beside the scan, the actions and the rewards.
So the actor's log of what it produced can be compared with what replay really holds, whatever happened between.
"""

from __future__ import annotations

import hashlib
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from appl_dist.spec import OBSERVATION_SIZE, SCAN
from appl_dist.wire.codec import shape_in

_REST_SIZE = OBSERVATION_SIZE - (SCAN.stop - SCAN.start)


@dataclass(frozen=True)
class Receipt:
    """digest: 16 hexadecimal digits."""

    transitions: int
    digest: str


def of_blob(blob: bytes) -> Receipt:
    """The receipt of an encoded rollout; ValueError if it is not one."""
    n, action_size = shape_in(blob)
    tail = 4 * ((n + 1) * _REST_SIZE + n * action_size + n)
    return Receipt(n, _digest(memoryview(blob)[-tail:]))


def of_arrays(rest: NDArray[np.float32], actions: NDArray[np.float32], rewards: NDArray[np.float32]) -> Receipt:
    """The same from rest (n + 1, 9), the observations beside the scan, actions (n, a) and rewards (n,)."""
    parts = (np.ascontiguousarray(array, "<f4").tobytes() for array in (rest, actions, rewards))
    return Receipt(len(actions), _digest(b"".join(parts)))


def _digest(data: bytes | memoryview) -> str:
    return hashlib.blake2b(data, digest_size=8).hexdigest()
