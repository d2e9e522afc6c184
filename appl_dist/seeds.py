"""Every random stream of a run as a named branch of one `numpy.random.SeedSequence` of `run.seed`.

Streams of different names, or of different run seeds, are independent; the same name and seed give the same stream.
"""

from __future__ import annotations

import zlib

import numpy as np


def stream(run_seed: int, *path: str | int) -> np.random.SeedSequence:
    """The branch named by `path`, such as ("learner", "replay") or ("actor", "actor-3", next_rollout, "noise")."""
    branch = [part if isinstance(part, int) else zlib.crc32(part.encode()) for part in path]
    return np.random.SeedSequence(run_seed, spawn_key=branch)


def generator(run_seed: int, *path: str | int) -> np.random.Generator:
    """A generator of that stream."""
    return np.random.default_rng(stream(run_seed, *path))


def integer(run_seed: int, *path: str | int) -> int:
    """A seed in 0..2^31 - 1 for what takes only a number."""
    return int(stream(run_seed, *path).generate_state(1)[0] >> 1)
