"""The run that a learner serves."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from appl_dist.policy_file import Training
from appl_dist.spec import ObservationLayout, ParameterSpace


@dataclass(frozen=True)
class Run:
    """What this run is: its id, folder, seed, length, and the frozen configuration served to actors."""

    run_id: str
    folder: Path
    seed: int
    transitions: int
    minutes: float
    config: dict[str, Any]
    space: ParameterSpace
    observation: ObservationLayout
    failed_time_s: float
    sigma: Callable[[int], float]  # exploration noise after so many transitions, for the status
    sync: bool = False  # what is acknowledged is on the disk
    training: Training | None = None  # what policy files say of where they come from
