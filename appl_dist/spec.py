"""Layouts that every process shares: observation, action, planner parameters, lidar and one rollout.

Leaf of the import graph: numpy and the standard library only, nothing of ours.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float32]

WIRE_VERSION = 4  # raised whenever a layout below or a wire header changes

VALUE_DECIMALS = 6  # of parameter values that an action stands for


@dataclass(frozen=True)
class ObservationLayout:
    """What an observation of `size` float32 entries means: its first `scan_size` are ranges scaled to [-1, 1].

    `name` and `version` say what the entries mean (policy/observation.py builds them); raise `version` when that
    changes. clip_m: ranges are clipped here.
    """

    name: str
    scan_size: int
    size: int
    clip_m: float
    version: int = 1

    def __post_init__(self) -> None:
        if not 0 <= self.scan_size <= self.size or self.size < 1:
            raise ValueError(f"observation {self.name!r}: scan of {self.scan_size} entries in {self.size}")


@dataclass(frozen=True)
class Parameter:
    """One tunable planner parameter and the box a policy may move it in."""

    name: str
    default: float
    low: float
    high: float
    unit: str = ""
    integer: bool = False


@dataclass(frozen=True)
class ParameterSpace:
    """An ordered set of parameters of one `planner`, and the affine map between them and actions in [-1, 1]."""

    name: str
    planner: str
    parameters: tuple[Parameter, ...]
    low: NDArray[np.float64] = field(init=False, repr=False, compare=False)
    high: NDArray[np.float64] = field(init=False, repr=False, compare=False)
    integer: NDArray[np.bool_] = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        for p in self.parameters:
            if not p.low < p.high:
                raise ValueError(f"{self.name}.{p.name}: bounds {p.low}..{p.high} are not increasing")
        object.__setattr__(self, "low", np.array([p.low for p in self.parameters]))
        object.__setattr__(self, "high", np.array([p.high for p in self.parameters]))
        object.__setattr__(self, "integer", np.array([p.integer for p in self.parameters]))

    def __len__(self) -> int:
        return len(self.parameters)

    @property
    def names(self) -> tuple[str, ...]:
        return tuple(p.name for p in self.parameters)

    @property
    def defaults(self) -> NDArray[np.float64]:
        """(n,) the expert's hand-tuned values."""
        return np.array([p.default for p in self.parameters])

    def to_values(self, action: NDArray[Any]) -> NDArray[np.float64]:
        """(n,) parameter values of an action in [-1, 1]; clipped to the box, integers rounded.

        The others are rounded to VALUE_DECIMALS, so that the float32 action of a value gives that
        value back: an inflation radius of 0.30000000045 m would inflate seven cells of 0.05 m where 0.3 inflates six.
        """
        unit = (np.clip(np.asarray(action, np.float64), -1.0, 1.0) + 1.0) / 2.0
        values: NDArray[np.float64] = self.low + unit * (self.high - self.low)
        return np.where(self.integer, np.rint(values), np.round(values, VALUE_DECIMALS))

    def to_action(self, values: NDArray[Any]) -> FloatArray:
        """(n,) action in [-1, 1] whose parameter values are `values`, clipped to the box."""
        unit = (np.asarray(values, np.float64) - self.low) / (self.high - self.low)
        return np.clip(2.0 * unit - 1.0, -1.0, 1.0).astype(np.float32)


@dataclass(frozen=True)
class LaserGeometry:
    """Where a lidar looks: `beams` spread evenly from -angle_max_rad to angle_max_rad about the robot's x axis.

    mount_x_m: it stands on that axis, so far ahead of base_link. The defaults are the Jackal's.
    """

    beams: int = 720
    mount_x_m: float = 0.055
    angle_max_rad: float = 2.35619


@dataclass(frozen=True)
class Rollout:
    """A run of n consecutive transitions of one episode, each observation once.

    observations (n + 1, size) float32, actions (n, a) float32 as executed (clipped), rewards (n,) float32. The first
    `scan_size` entries of an observation are its scan, in [-1, 1]. `terminal`: the last transition ended the episode
    for good; without it the run was truncated (time limit, or the actor stopping) and learning bootstraps from the
    last observation. `info` holds plain msgpack values: world, seed, success, collision, time_s, distance_m, return,
    and the `policy_version` that chose the actions.
    """

    observations: FloatArray
    actions: FloatArray
    rewards: FloatArray
    terminal: bool
    info: dict[str, Any]
    scan_size: int

    def __len__(self) -> int:
        return len(self.rewards)

    def check(self) -> None:
        """Raise ValueError naming the first field whose shape, dtype or numbers cannot be."""
        n = len(self.rewards)
        wanted = {
            "observations": (self.observations, (n + 1, *self.observations.shape[1:2])),
            "actions": (self.actions, (n, *self.actions.shape[1:2])),
            "rewards": (self.rewards, (n,)),
        }
        if n < 1:
            raise ValueError("rewards: got 0 transitions; a rollout has at least 1")
        for name, (array, shape) in wanted.items():
            wrong = array.shape != shape or (name != "rewards" and array.ndim != 2)
            if wrong or array.dtype != np.float32:
                raise ValueError(f"{name}: got {array.dtype}{array.shape}; expected float32{shape}")
            if not np.isfinite(array).all():
                raise ValueError(f"{name}: holds a value that is not finite")
        if not 0 <= self.scan_size <= self.observations.shape[1]:
            raise ValueError(f"observations: got {self.observations.shape[1]} entries with a scan of {self.scan_size}")
        if np.abs(self.actions).max(initial=0.0) > 1.0:
            raise ValueError(f"actions: got {np.abs(self.actions).max():g}; allowed -1..1")
