"""One episode of a policy in an environment: as transitions for the learner, or as a result for an evaluation."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np

from appl_dist.actor.env import NavigationEnv
from appl_dist.spec import FloatArray, Rollout


class Policy(Protocol):
    def act(self, observation: FloatArray) -> FloatArray:
        """Action (n,) in [-1, 1] for an observation (729,)."""
        ...


@dataclass(frozen=True)
class EpisodeResult:
    """What one trial came to. time_s is the protocol's clock, also of a trial that failed."""

    world: int
    seed: int | None
    success: bool
    time_s: float
    collided: bool
    rolled_over: bool
    timeout: bool
    distance_m: float
    min_clearance_m: float
    return_: float
    decisions: int
    recoveries: int


def collect(
    env: NavigationEnv,
    choose: Callable[[FloatArray], FloatArray],
    *,
    seed: int | None = None,
    world: int | None = None,
    stop: Callable[[], bool] = lambda: False,
) -> Rollout | None:
    """Run one episode and return its transitions; None if `stop()` came true before the first.

    Actions are clipped to [-1, 1] before they are executed, and stored as executed. An episode that `stop()` cuts
    short is a truncated rollout: its transitions are as good as any.
    """
    observation, info = env.reset(seed=seed, options=None if world is None else {"world": world})
    observations, actions, rewards = [observation], [], []
    terminated = truncated = False
    while not (terminated or truncated or stop()):
        action = np.clip(choose(observation), -1.0, 1.0).astype(np.float32)
        observation, reward, terminated, truncated, info = env.step(action)
        observations.append(observation)
        actions.append(action)
        rewards.append(reward)
    if not actions:
        return None
    return Rollout(
        np.stack(observations),
        np.stack(actions),
        np.asarray(rewards, np.float32),
        terminated,
        _episode_info(info, float(np.sum(rewards)), ended=terminated or truncated, seed=seed),
    )


def run_episode(
    env: NavigationEnv, policy: Policy, *, seed: int | None = None, world: int | None = None
) -> EpisodeResult:
    """One trial of `policy`, without exploration."""
    rollout = collect(env, policy.act, seed=seed, world=world)
    assert rollout is not None  # without `stop` an episode has at least one decision
    i = rollout.info
    return EpisodeResult(
        world=i["world"],
        seed=seed,
        success=i["success"],
        time_s=i["time_s"],
        collided=i["collision"],
        rolled_over=i["rolled_over"],
        timeout=not rollout.terminal,
        distance_m=i["distance_m"],
        min_clearance_m=i["min_clearance_m"],
        return_=i["return"],
        decisions=len(rollout),
        recoveries=i["recoveries"],
    )


def _episode_info(info: dict[str, Any], return_: float, *, ended: bool, seed: int | None) -> dict[str, Any]:
    """Plain values of an episode's last info, fit for msgpack; `ended` is false for one cut short."""
    return {
        "world": int(info["world"]),
        "seed": seed,
        "ended": ended,
        "success": bool(info["success"]),
        "collision": bool(info["collision"]),
        "rolled_over": bool(info["rolled_over"]),
        "time_s": float(info["time_s"]),
        "distance_m": float(info["distance_m"]),
        "min_clearance_m": float(info["min_clearance_m"]),
        "recoveries": int(info["recoveries"]),
        "return": return_,
    }
