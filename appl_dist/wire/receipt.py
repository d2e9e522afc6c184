"""What identifies a rollout on both sides of the wire: how many transitions, and a digest of their exact bytes.

The digest covers what replay keeps bit for bit: the observations beside the scan, the actions and the rewards.
So the actor's log of what it produced can be compared with what replay really holds, whatever happened between.
"""

from __future__ import annotations

import hashlib
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from appl_dist.wire.codec import sizes_in


@dataclass(frozen=True)
class Receipt:
    """digest: 16 hexadecimal digits."""

    transitions: int
    digest: str


def of_blob(blob: bytes) -> Receipt:
    """The receipt of an encoded rollout; ValueError if it is not one."""
    sizes = sizes_in(blob)
    tail = sum(sizes.array_bytes()[1:])
    return Receipt(sizes.transitions, _digest(memoryview(blob)[-tail:]))


def of_arrays(rest: NDArray[np.float32], actions: NDArray[np.float32], rewards: NDArray[np.float32]) -> Receipt:
    """The same from rest (n + 1, r), the observations beside the scan, actions (n, a) and rewards (n,)."""
    parts = (np.ascontiguousarray(array, "<f4").tobytes() for array in (rest, actions, rewards))
    return Receipt(len(actions), _digest(b"".join(parts)))


def _digest(data: bytes | memoryview) -> str:
    return hashlib.blake2b(data, digest_size=8).hexdigest()
