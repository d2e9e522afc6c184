"""A few threads that share out the pieces of a step."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Any, TypeVar

import torch

T = TypeVar("T")


class Workers:
    """Runs pieces on `threads` threads: the caller's and a pool of the others."""

    def __init__(self, threads: int = 1) -> None:
        self.threads = threads
        # The flag is per thread; without it a piece's bits and speed would depend on who computes it.
        flush = lambda: torch.set_flush_denormal(True)  # noqa: E731
        self._pool = ThreadPoolExecutor(threads - 1, "learner", flush) if threads > 1 else None

    def each(self, work: Callable[[T], None], pieces: Sequence[T]) -> None:
        """work(piece) for every piece; returns when all are done."""
        if self._pool is None:
            for piece in pieces:
                work(piece)
            return
        later = [self._pool.submit(work, piece) for piece in pieces[1:]]
        work(pieces[0])
        for future in later:
            future.result()

    def __deepcopy__(self, memo: dict[int, Any]) -> Workers:
        """Copies of a network share the threads."""
        return self
