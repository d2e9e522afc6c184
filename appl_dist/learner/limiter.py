"""Samples-per-insert limiter: keeps learning and collecting in step, bounded on both sides.

The idea is Reverb's (Cassirer et al., 2021, Sec. 3.4). With S = samples_per_insert, I transitions inserted
and T transitions sampled, it keeps  |S (I - min_transitions) - T| <= error_buffer : sampling waits when it
has reused the data too often, inserting waits (back-pressure to the actors) when learning falls behind.
"""

from __future__ import annotations

import math
import threading
from dataclasses import dataclass


@dataclass(frozen=True)
class LimiterSettings:
    """`samples_per_insert` transitions are sampled for each one inserted, once `min_transitions` are in.

    `error_buffer`, in sampled transitions, is how far the two may drift; inf means no limit on either side.
    `largest_insert` and `batch_size` are the most one call inserts or samples: a buffer too narrow for them
    could stop both sides for good, and is refused.
    """

    samples_per_insert: float = 32.0
    min_transitions: int = 5_000
    error_buffer: float = 160_000.0
    largest_insert: int = 100
    batch_size: int = 256

    def __post_init__(self) -> None:
        if not (math.isfinite(self.samples_per_insert) and self.samples_per_insert > 0):
            raise ValueError(f"samples_per_insert: got {self.samples_per_insert}; allowed above 0")
        for name in ("min_transitions", "largest_insert", "batch_size"):
            if getattr(self, name) < 1:
                raise ValueError(f"{name}: got {getattr(self, name)}; at least 1")
        least = (self.samples_per_insert * self.largest_insert + self.batch_size) / 2
        if not self.error_buffer >= least:
            raise ValueError(
                f"error_buffer: got {self.error_buffer:g}; at least {least:g} = (samples_per_insert "
                f"{self.samples_per_insert:g} x largest_insert {self.largest_insert} + batch_size "
                f"{self.batch_size}) / 2, or inserting and sampling could wait for each other for ever"
            )
        first = self.samples_per_insert * self.min_transitions + self.error_buffer
        if first < self.samples_per_insert * self.largest_insert:
            raise ValueError(
                f"largest_insert: got {self.largest_insert}; with min_transitions {self.min_transitions} and "
                f"error_buffer {self.error_buffer:g} such an insert would never be let in"
            )


class RateLimiter:
    """Counts inserts and samples and says which may go on. Thread-safe.

    `inserted` and `sampled` continue an earlier run. A run whose replay was lost starts both at 0.
    """

    def __init__(self, settings: LimiterSettings, inserted: int = 0, sampled: int = 0) -> None:
        self.settings = settings
        self._inserted, self._sampled = inserted, sampled
        self._change = threading.Condition()

    @property
    def inserted(self) -> int:
        """Transitions inserted."""
        return self._inserted

    @property
    def sampled(self) -> int:
        """Transitions sampled, with repeats."""
        return self._sampled

    def may_insert(self, n: int) -> bool:
        """Whether n more transitions may be inserted now."""
        s = self.settings
        ahead = s.samples_per_insert * (self._inserted + n - s.min_transitions) - self._sampled
        return ahead <= s.error_buffer

    def may_sample(self, n: int) -> bool:
        """Whether n more transitions may be sampled now."""
        s = self.settings
        ahead = s.samples_per_insert * (self._inserted - s.min_transitions) - self._sampled
        return self._inserted >= s.min_transitions and ahead - n >= -s.error_buffer

    def count_insert(self, n: int) -> None:
        """n transitions were inserted."""
        with self._change:
            self._inserted += n
            self._change.notify_all()

    def count_sample(self, n: int) -> None:
        """n transitions were sampled."""
        with self._change:
            self._sampled += n
            self._change.notify_all()

    def wait_to_insert(self, n: int, timeout_s: float) -> bool:
        """Wait until n transitions may be inserted; False after `timeout_s`."""
        with self._change:
            return self._change.wait_for(lambda: self.may_insert(n), timeout_s)

    def wait_to_sample(self, n: int, timeout_s: float) -> bool:
        """Wait until n transitions may be sampled; False after `timeout_s`."""
        with self._change:
            return self._change.wait_for(lambda: self.may_sample(n), timeout_s)

    def describe(self) -> str:
        """One line: what was counted, which side waits, and for what."""
        s = self.settings
        ratio = self._sampled / self._inserted if self._inserted else 0.0
        line = f"{self._sampled} samples of {self._inserted} inserts ({ratio:.1f} each)"
        if self._inserted < s.min_transitions:
            return f"{line}; learning waits for {s.min_transitions} transitions"
        if not self.may_sample(s.batch_size):
            return f"{line}; learning waits for data (samples_per_insert {s.samples_per_insert:g})"
        if not self.may_insert(s.largest_insert):
            return f"{line}; actors wait for learning (samples_per_insert {s.samples_per_insert:g})"
        return line
