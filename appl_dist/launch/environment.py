"""The environment that settings describe: its worlds, and its arguments."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from appl_dist.actor.env import NavigationEnv
from appl_dist.actor.world_split import select_worlds
from appl_dist.config import Settings
from appl_dist.errors import UserError
from appl_dist.planner.parameters import Arithmetic, PlannerSettings
from appl_dist.sim.worlds import World
from appl_dist.spec import SPACES

EVALUATION = "evaluation_of"  # in what is served to actors: no training run, but trials under these settings


def worlds_of(settings: Settings, split: str) -> list[World]:
    """The worlds of a split, such as `settings.world.train`. Raises UserError."""
    return select_worlds(settings.world.path, settings.world.count, settings.world.seed, split)


def environment_arguments(settings: Settings, arithmetic: Arithmetic | None = None) -> dict[str, Any]:
    """Arguments of `NavigationEnv` beside the worlds and the protocol; arithmetic: instead of the planner's own."""
    return {
        "decision_period_s": settings.env.decision_period_s,
        "space": SPACES[settings.env.space],
        "timing": settings.timing,
        "rewards": settings.reward,
        "planner": replace(settings.planner, arithmetic=arithmetic or settings.planner.arithmetic),
        "robot": settings.robot,
        "lidar": settings.lidar,
    }


def check_environment(settings: Settings) -> None:
    """Build once what every actor and worker builds. UserError: worlds, planner, robot or timing that cannot be."""
    worlds_of(settings, settings.evaluation.worlds)
    worlds = worlds_of(settings, settings.world.train)
    try:
        env = NavigationEnv(worlds[:1], protocol=settings.protocol, **environment_arguments(settings))
        env.reset(seed=0)
        env.close()
    except (ValueError, OverflowError, MemoryError) as error:
        sentence = str(error) or "planner: the maps do not fit into memory"
        field = sentence.partition(":")[0]
        if field == "pose":
            sentence = f"protocol.start_x_m, protocol.start_y_m: {sentence.partition(': ')[2]}"
        group = "planner." if field in PlannerSettings.__dataclass_fields__ else ""
        raise UserError(f"{group}{sentence}") from None
