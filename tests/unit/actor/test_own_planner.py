"""A planner written in Python, as users add it, in the loop of the simulator."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np
import pytest

from appl_dist.actor.env import NavigationEnv
from appl_dist.actor.rollout import run_episode
from appl_dist.planner.navigator import Navigator
from appl_dist.planner.planner_settings import PlannerSettings
from appl_dist.planner.planners import PLANNERS, PlannerKind
from appl_dist.policy.fixed import default_policy
from appl_dist.sim.generate import generate_worlds


class Wrapped:
    """The navigator called through Python: every method of the interface, and no shortcut."""

    fault: Exception | None = None
    command: tuple[float, float] | None = None

    def __init__(self, settings: PlannerSettings, laser) -> None:
        self.inner = Navigator(settings, laser)

    def control(self, pose, twist, now_s):
        if self.fault is not None:
            raise self.fault
        return self.inner.control(pose, twist, now_s) if self.command is None else self.command

    def __getattr__(self, name: str):
        if name == "native":
            raise AttributeError(name)
        return getattr(self.inner, name)


@pytest.fixture
def env(monkeypatch: pytest.MonkeyPatch) -> Iterator[NavigationEnv]:
    kinds = PLANNERS._entries | {"wrapped": PlannerKind(Wrapped, PLANNERS.get("dwa").spaces)}
    monkeypatch.setattr(PLANNERS, "_entries", kinds)
    made = NavigationEnv(generate_worlds(2, 0), planner=PlannerSettings(name="wrapped"))
    yield made
    made.close()


def test_it_drives_as_the_same_planner_in_c_bit_for_bit(env: NavigationEnv) -> None:
    with_c = NavigationEnv(generate_worlds(2, 0))
    for world in (0, 1):
        ours, theirs = (run_episode(e, default_policy(e.space), seed=5, world=world) for e in (env, with_c))
        assert ours.digest == theirs.digest
        assert ours.success == theirs.success


def test_what_it_raises_comes_out_of_the_step_and_the_next_episode_runs(env: NavigationEnv) -> None:
    env.reset(seed=0, options={"world": 0})
    env.loop.planner.fault = RuntimeError("no way")
    with pytest.raises(RuntimeError, match="no way"):
        env.step(np.zeros(8, np.float32))
    env.loop.planner.fault = None
    env.reset(seed=0, options={"world": 0})
    env.step(np.zeros(8, np.float32))
    assert env.loop.now_ms == 2000


def test_a_command_that_is_not_finite_is_refused(env: NavigationEnv) -> None:
    env.reset(seed=0, options={"world": 0})
    env.loop.planner.command = (math.nan, 0.0)
    with pytest.raises(ValueError, match="planner: control returned a command that is not finite"):
        env.step(np.zeros(8, np.float32))
