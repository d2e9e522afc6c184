"""The observation that a policy sees, built in one place for the simulator and for robots.

Input: ranges, the bearing of the local goal, the parameters in force. Output: float32 entries in [-1, 1], in the order
of a named `ObservationLayout`. OBSERVATIONS is where a user adds his own.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from appl_dist.registry import Registry
from appl_dist.spec import FloatArray, ObservationLayout, ParameterSpace

PAPER = "paper"
CLIP_M = 2.0  # of the papers' ranges


@dataclass(frozen=True)
class ObservationSettings:
    """What a policy sees. name: an entry of OBSERVATIONS."""

    name: str = PAPER


class ObservationBuilder(Protocol):
    """Builds observations of one layout."""

    @property
    def layout(self) -> ObservationLayout: ...

    def build(self, ranges: FloatArray, bearing_rad: float, values: NDArray[np.float64]) -> FloatArray:
        """(size,) float32. ranges (beams,) m, inf = no return; bearing of the local goal in the robot frame, rad;
        values (n,) of the parameters in force.
        """
        ...


class PaperObservation:
    """The papers' observation (APPL journal, Sec. V-D): the clipped ranges, the bearing / pi, the parameters."""

    def __init__(self, beams: int, space: ParameterSpace) -> None:
        self.layout = ObservationLayout(PAPER, beams, beams + 1 + len(space), CLIP_M)
        self._space = space

    def build(self, ranges: FloatArray, bearing_rad: float, values: NDArray[np.float64]) -> FloatArray:
        beams, clip_m = self.layout.scan_size, self.layout.clip_m
        observation = np.empty(self.layout.size, np.float32)
        scan = observation[:beams]
        np.minimum(ranges, clip_m, out=scan)
        scan *= 2.0 / clip_m
        scan -= 1.0
        observation[beams] = bearing_rad / math.pi
        observation[beams + 1 :] = self._space.to_action(values)
        return observation


# Name to a factory, which gets the number of lidar beams and the parameter space.
OBSERVATIONS: Registry[Callable[[int, ParameterSpace], ObservationBuilder]] = Registry(
    "observation", {PAPER: PaperObservation}
)


def layout_of(name: str, beams: int, space: ParameterSpace) -> ObservationLayout:
    """The layout of the registered observation `name`; UserError lists the names."""
    return OBSERVATIONS.get(name)(beams, space).layout
