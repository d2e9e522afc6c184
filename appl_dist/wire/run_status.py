"""What members of a run say about themselves: an actor's progress, and the learner's status for views and checks."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

from appl_dist.wire.typed import MAX_COUNT, Range

MAX_PENDING = 10**7  # rollouts in one spool


@dataclass(frozen=True)
class Progress:
    """How far an actor is.

    world: index, -1 between episodes. policy_version: in use, -1 before the first. pending: rollouts not yet sent.
    """

    world: Annotated[int, Range(-1, MAX_COUNT)] = -1
    policy_version: Annotated[int, Range(-1, MAX_COUNT)] = -1
    transitions: Annotated[int, Range(0, 10**12)] = 0
    pending: Annotated[int, Range(0, MAX_PENDING)] = 0
    host: str = ""


@dataclass(frozen=True)
class EpisodeInfo:
    """What a rollout's info must hold for the episode's figures. ended: false for an episode that was cut short."""

    world: Annotated[int, Range(0, 10**9)]
    ended: bool
    success: bool
    time_s: Annotated[float, Range(0, 1e6)]
    return_: Annotated[float, Range(-1e9, 1e9)]
    policy_epoch: Annotated[int, Range(0, MAX_COUNT)]
    policy_version: Annotated[int, Range(0, MAX_COUNT)]


@dataclass(frozen=True)
class ActorStatus:
    """One actor as the learner sees it. silent_s: since it was last heard of; pending: rollouts not yet sent."""

    id: str
    transitions_per_s: Annotated[float, Range(0, 1e16)]
    world: Annotated[int, Range(-1, MAX_COUNT)]
    version: Annotated[int, Range(-1, MAX_COUNT)]
    pending: Annotated[int, Range(0, MAX_PENDING)]
    silent_s: Annotated[float, Range(0, 1e12)]
    host: str


@dataclass(frozen=True)
class RunStatus:
    """A learner's numbers.

    run_transitions: the run's length. age_s: how old these numbers are. queue: rollouts that wait in all spools.
    success (share), time_s, return_ of recent episodes, None before the first. staleness: policy versions;
    stale_share: of transitions. sigma: exploration noise. refused: refused messages by sender. held_back: which side
    of the rate limiter waits, as a sentence, or "".
    """

    run_id: str
    run_transitions: int
    transitions: int
    updates: int
    elapsed_s: float
    age_s: float
    transitions_per_s: float
    updates_per_s: float
    samples_per_insert: float
    queue: int
    version: int
    sigma: float
    episodes: int
    success: float | None
    time_s: float | None
    return_: float | None
    staleness: float
    stale_share: float
    refused: dict[str, int]
    held_back: str
    actors: tuple[ActorStatus, ...]
