"""An actor: episodes with the newest policy and exploration noise, into the spool, for as long as the run lasts.

In: worlds, weights from the learner. Out: rollouts in the spool, which the uploader drains, and a heartbeat.
"""

from __future__ import annotations

import logging
import time
from collections.abc import Callable
from dataclasses import replace
from typing import Protocol

import numpy as np

from appl_dist.actor.env import NavigationEnv
from appl_dist.actor.exploration import ExplorationSettings, explore
from appl_dist.actor.rollout import collect
from appl_dist.errors import UserError
from appl_dist.policy.load import policy_from_file
from appl_dist.policy.network import MLPPolicy
from appl_dist.policy_file import PolicyFile
from appl_dist.spec import FloatArray
from appl_dist.wire.codec import encode_rollout
from appl_dist.wire.run_status import Progress

log = logging.getLogger(__name__)

HOLD_S = 0.02
FULL_S = 0.5  # between looks at `stop` while the spool is full


class Weights(Protocol):
    """Where new weights come from: wire/weights.py or its in-memory twin."""

    def latest(self) -> tuple[int, int, bytes] | None: ...


class Sink(Protocol):
    """Where rollouts go, encoded for the wire: the spool, whose `put` waits while it is full."""

    def __len__(self) -> int: ...

    def put(self, blob: bytes, timeout_s: float | None = None, beyond: bool = False) -> int | None: ...


class Explorer:
    """The newest policy plus exploration noise; asks for new weights before every decision."""

    def __init__(
        self,
        weights: Weights,
        env: NavigationEnv,
        settings: ExplorationSettings,
        rng: np.random.Generator,
    ) -> None:
        self._weights = weights
        self._space, self._layout = env.space, env.observation_builder.layout
        self._settings = settings
        self._rng = rng
        self._held: tuple[int, int] = (-1, -1)
        self._policy: MLPPolicy | None = None

    @property
    def held(self) -> tuple[int, int]:
        """(epoch, version) of the policy in use; (-1, -1) before any has arrived."""
        return self._held

    @property
    def version(self) -> int:
        """Version of the policy in use; -1 before any has arrived."""
        return self._held[1]

    def choose(self, observation: FloatArray) -> FloatArray:
        """(n,) action to execute and store."""
        self._refresh()
        if self._policy is None:  # nothing broadcast yet: as good as the uniform phase
            return self._rng.uniform(-1.0, 1.0, len(self._space)).astype(np.float32)
        transitions = self._policy.file.transitions
        action = self._policy.act(observation)
        return explore(action, self._settings, transitions, self._rng)

    def _refresh(self) -> None:
        newest = self._weights.latest()
        if newest is None or newest[:2] <= self._held:
            return
        self._held = newest[:2]
        try:
            policy = policy_from_file(
                PolicyFile.from_bytes(newest[2]), self._space, "weights of the learner", self._layout
            )
            assert isinstance(policy, MLPPolicy)
            self._policy = policy
        except UserError as error:
            log.warning("%s; going on with the old policy", error)


def act(
    env: NavigationEnv,
    explorer: Explorer,
    sink: Sink,
    *,
    seed: int,
    stop: Callable[[], bool],
    beat: Callable[[Progress], object],
    hold: Callable[[], bool] = lambda: False,
) -> int:
    """Run episodes into `sink` until `stop()`; returns how many transitions were made.

    stop: asked before every decision. beat: called before every decision with how far the actor is.
    hold: asked before every episode; true while the learner wants no more for now.
    """
    made = decisions = 0
    world = -1  # none: held back

    def tell() -> None:
        beat(Progress(world, explorer.version, decisions, len(sink)))

    def choose(observation: FloatArray) -> FloatArray:
        nonlocal decisions
        decisions += 1
        tell()
        return explorer.choose(observation)

    env.reset(seed=seed)
    while not stop():
        if hold():
            world = -1
            tell()
            time.sleep(HOLD_S)
            continue
        world = env.next_world()
        epoch, version = explorer.held
        rollout = collect(env, choose, world=world, stop=stop)
        if rollout is None:
            break
        info = {**rollout.info, "policy_epoch": max(epoch, 0), "policy_version": max(version, 0)}
        blob = encode_rollout(replace(rollout, info=info))
        while sink.put(blob, FULL_S) is None:
            world = -1
            tell()
            if stop():
                sink.put(blob, 0.0, beyond=True)
                break
        made += len(rollout)
    return made
