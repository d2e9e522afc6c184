"""One episode of a policy in an environment: as transitions for the learner, or as a result for an evaluation."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from appl_dist.actor.env import NavigationEnv
from appl_dist.spec import FloatArray, Rollout


class Policy(Protocol):
    def act(self, observation: FloatArray) -> FloatArray:
        """Action (n,) in [-1, 1] for an observation (size,)."""
        ...


@dataclass(frozen=True)
class EpisodeResult:
    """What one trial came to. time_s is the protocol's clock, also of a trial that failed.

    parameters: (decisions, n) planner parameter values in force. trajectory: (samples, 6), `loop.TRAJECTORY`.
    """

    world: int
    seed: int
    success: bool
    time_s: float
    collisions: int
    rolled_over: bool
    timeout: bool
    distance_m: float
    min_clearance_m: float
    return_: float
    recoveries: int
    parameters: NDArray[np.float64]
    trajectory: NDArray[np.float64]
    digest: str  # of the trajectory

    @property
    def decisions(self) -> int:
        return len(self.parameters)

    @property
    def collided(self) -> bool:
        return self.collisions > 0


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
        env.observation_builder.layout.scan_size,
    )


def run_episode(env: NavigationEnv, policy: Policy, *, seed: int, world: int) -> EpisodeResult:
    """One trial of `policy`, without exploration. A fixed set is in force as given, not rounded to an action."""
    fixed = getattr(policy, "values", None)

    def step(observation: FloatArray) -> tuple[FloatArray, float, bool, bool, dict[str, Any]]:
        if fixed is not None:
            return env.step_values(fixed)
        return env.step(np.clip(policy.act(observation), -1.0, 1.0).astype(np.float32))

    return _drive(env, step, seed, world)


def repeat_episode(env: NavigationEnv, parameters: NDArray[np.float64], *, seed: int, world: int) -> EpisodeResult:
    """The trial whose parameter values (decisions, n) were `parameters`: no policy is needed, only the same code."""
    rows = iter(parameters)
    try:
        return _drive(env, lambda _: env.step_values(next(rows)), seed, world)
    except StopIteration:
        raise ValueError(f"parameters: {len(parameters)} decisions did not end the trial") from None


def _drive(
    env: NavigationEnv,
    step: Callable[[FloatArray], tuple[FloatArray, float, bool, bool, dict[str, Any]]],
    seed: int,
    world: int,
) -> EpisodeResult:
    observation, info = env.reset(seed=seed, options={"world": world})
    parameters, return_ = [], 0.0
    terminated = truncated = False
    while not (terminated or truncated):
        observation, reward, terminated, truncated, info = step(observation)
        parameters.append(info["parameters"])
        return_ += reward
    return EpisodeResult(
        world=info["world"],
        seed=seed,
        success=info["success"],
        time_s=info["time_s"],
        collisions=info["collisions"],
        rolled_over=info["rolled_over"],
        timeout=truncated,
        distance_m=info["distance_m"],
        min_clearance_m=info["min_clearance_m"],
        return_=return_,
        recoveries=info["recoveries"],
        parameters=np.array(parameters),
        trajectory=env.loop.trajectory,
        digest=env.loop.digest(),
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
        "return_": return_,
    }
