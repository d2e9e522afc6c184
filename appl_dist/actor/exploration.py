"""Exploration: what an actor adds to the policy's action, as a function of the learner's transition count."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from appl_dist.spec import FloatArray


@dataclass(frozen=True)
class ExplorationSettings:
    """Gaussian noise whose standard deviation falls linearly from sigma_start to sigma_floor.

    The papers start at 0.5, fall by 0.125 per million transitions and stop at 0.02, after 3.84 of their 5 million:
    `decay_fraction` of the run's transitions, so that the schedule scales with the run.
    uniform_fraction: share of the run's transitions, at its start, whose actions are uniform in the box.
    horizon: the run's length that the schedule is made for, transitions; 0 takes that of the run when it is made. It
        stays when a run is made longer, so that the noise never rises again.
    """

    sigma_start: float = 0.5
    sigma_floor: float = 0.02
    decay_fraction: float = 0.768
    uniform_fraction: float = 0.02
    horizon: int = 0

    def __post_init__(self) -> None:
        for name in ("sigma_start", "sigma_floor", "decay_fraction", "uniform_fraction"):
            if not 0.0 <= getattr(self, name) <= 1.0:
                raise ValueError(f"explore.{name}: got {getattr(self, name)}; allowed 0..1")
        if not 0 <= self.horizon <= 10**10:
            raise ValueError(f"explore.horizon: got {self.horizon}; allowed 0..1e10 transitions")
        if self.sigma_floor > self.sigma_start:
            raise ValueError(
                f"explore.sigma_floor: got {self.sigma_floor}; allowed at most sigma_start {self.sigma_start}"
            )

    def sigma(self, transitions: int) -> float:
        """Standard deviation after so many transitions of the run."""
        decay = self.decay_fraction * max(self.horizon, 1)
        done = min(1.0, transitions / decay) if decay > 0.0 else 1.0
        return self.sigma_start + (self.sigma_floor - self.sigma_start) * done


def explore(
    action: FloatArray,
    settings: ExplorationSettings,
    transitions: int,
    rng: np.random.Generator,
) -> FloatArray:
    """The action to execute and to store: (n,) in [-1, 1], after noise and clipping."""
    if transitions < settings.uniform_fraction * settings.horizon:
        return rng.uniform(-1.0, 1.0, action.shape).astype(np.float32)
    noise = rng.normal(0.0, settings.sigma(transitions), action.shape)
    return np.clip(action + noise, -1.0, 1.0).astype(np.float32)
