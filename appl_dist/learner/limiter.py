"""Samples-per-insert limiter: keeps learning and collecting in step, bounded on both sides.

The idea is Reverb's (Cassirer et al., 2021, Sec. 3.4). With S = samples_per_insert, I transitions inserted
and T transitions sampled, it keeps  |I - min_transitions - T / S| <= tolerance : sampling waits when it has
used the data S times over, inserting waits (back-pressure to the actors) when learning falls behind.
"""

from __future__ import annotations

import math
import threading
from dataclasses import dataclass

_ROUNDING = 1e-6  # of `_ahead`, so that the narrowest tolerance allowed cannot lock both sides


@dataclass(frozen=True)
class LimiterSettings:
    """`samples_per_insert` transitions are sampled for each one inserted, once `min_transitions` are in.

    `tolerance`, in inserted transitions, is how far either side may run ahead; inf means without limit.
    `largest_insert` and `batch_size` are the most one call inserts or samples: a tolerance too narrow for
    them could stop both sides for good, and is refused.
    """

    samples_per_insert: float
    min_transitions: int
    tolerance: float
    largest_insert: int = 100
    batch_size: int = 256

    def __post_init__(self) -> None:
        if not (math.isfinite(self.samples_per_insert) and self.samples_per_insert > 0):
            raise ValueError(f"samples_per_insert: got {self.samples_per_insert}; allowed above 0")
        for name in ("min_transitions", "largest_insert", "batch_size"):
            if getattr(self, name) < 1:
                raise ValueError(f"{name}: got {getattr(self, name)}; at least 1")
        least = (self.largest_insert + self.batch_size / self.samples_per_insert) / 2
        if not self.tolerance >= least:
            raise ValueError(
                f"tolerance: got {self.tolerance:g} transitions; at least {least:g} = (largest_insert "
                f"{self.largest_insert} + batch_size {self.batch_size} / samples_per_insert "
                f"{self.samples_per_insert:g}) / 2, or inserting and sampling could each wait for the other "
                "for ever"
            )


class RateLimiter:
    """Says which side may go on, and counts what it allowed. Thread-safe.

    `inserted` and `sampled` (transitions, the latter with repeats) continue an earlier run.
    """

    def __init__(self, settings: LimiterSettings, inserted: int = 0, sampled: int = 0) -> None:
        self.settings = settings
        self._inserted, self._sampled = inserted, sampled
        self._open = False
        self._lock = threading.Lock()

    @property
    def inserted(self) -> int:
        """Transitions allowed in."""
        return self._inserted

    @property
    def sampled(self) -> int:
        """Transitions allowed out, with repeats."""
        return self._sampled

    def may_insert(self, n: int) -> bool:
        """Whether n more transitions may be inserted now. True counts them as inserted."""
        with self._lock:
            # Below min_transitions sampling cannot free anybody, so inserting never waits there.
            starting = self._inserted < self.settings.min_transitions
            allowed = self._open or starting or self._ahead(n, 0) <= self.settings.tolerance + _ROUNDING
            self._inserted += n if allowed else 0
            return allowed

    def may_sample(self, n: int) -> bool:
        """Whether n more transitions may be sampled now. True counts them as sampled."""
        with self._lock:
            enough = self._inserted >= self.settings.min_transitions
            allowed = enough and (self._open or self._ahead(0, n) >= -self.settings.tolerance - _ROUNDING)
            self._sampled += n if allowed else 0
            return allowed

    def give_back(self, inserts: int) -> None:
        """Take back a permission whose insert failed."""
        with self._lock:
            self._inserted -= inserts

    def open(self) -> None:
        """Lift the limits, so that what is on its way can still come in at the end of a run."""
        with self._lock:
            self._open = True

    @property
    def actors_wait(self) -> bool:
        """Whether the actors' next episode has to wait for learning."""
        s = self.settings
        with self._lock:
            started = not self._open and self._inserted >= s.min_transitions
            return started and self._ahead(s.largest_insert, 0) > s.tolerance

    def describe(self) -> str:
        """One line: what was counted, and which side waits for what."""
        s = self.settings
        with self._lock:
            line = f"{self._sampled} samples of {self._inserted} transitions"
            if self._inserted < s.min_transitions:
                return f"{line}; learning waits for min_transitions {s.min_transitions}"
            if self._ahead(0, s.batch_size) < -s.tolerance and not self._open:
                return f"{line}; learning waits for the actors (samples_per_insert {s.samples_per_insert:g})"
            if self._ahead(s.largest_insert, 0) > s.tolerance and not self._open:
                return f"{line}; actors wait for learning (samples_per_insert {s.samples_per_insert:g})"
            return line

    def _ahead(self, inserts: int, samples: int) -> float:
        """How far inserting would be ahead of sampling, in transitions, after so many more of each."""
        s = self.settings
        return self._inserted + inserts - s.min_transitions - (self._sampled + samples) / s.samples_per_insert
