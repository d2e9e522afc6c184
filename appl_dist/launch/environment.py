"""The environment that settings describe: its worlds, and its arguments."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path
from typing import Any

from appl_dist.actor.env import NavigationEnv
from appl_dist.actor.world_split import select_worlds
from appl_dist.config import Settings, as_dict
from appl_dist.errors import UserError
from appl_dist.planner.planner_settings import Arithmetic, PlannerSettings
from appl_dist.planner.planners import PLANNERS
from appl_dist.policy.observation import layout_of
from appl_dist.policy_file import PolicyFile, Training
from appl_dist.sim.worlds import World, course_of
from appl_dist.spec import ObservationLayout, ParameterSpace

_PLACES = ("run", "actors", "serial", "actor", "wire", "evaluation", "launch")  # settings without meaning for learning
EVALUATION = "evaluation_of"  # in what is served to actors: no training run, but trials under these settings


def worlds_of(settings: Settings, split: str) -> list[World]:
    """The worlds of a split, such as `settings.world.train`. Raises UserError."""
    return select_worlds(settings.world.path, settings.world.count, settings.world.seed, split)


def space_of(settings: Settings) -> ParameterSpace:
    """The box in which a policy of this run moves the planner's parameters."""
    return PLANNERS.get(settings.planner.name).space(settings.env.space)


def observation_of(settings: Settings) -> ObservationLayout:
    """The layout of what a policy of this run sees."""
    return layout_of(settings.observation.name, settings.lidar.beams, space_of(settings))


def environment_arguments(settings: Settings, arithmetic: Arithmetic | None = None) -> dict[str, Any]:
    """Arguments of `NavigationEnv` beside the worlds and the protocol; arithmetic: instead of the planner's own."""
    return {
        "decision_period_s": settings.env.decision_period_s,
        "space": space_of(settings),
        "observation": settings.observation,
        "timing": settings.timing,
        "rewards": settings.reward,
        "planner": replace(settings.planner, arithmetic=arithmetic or settings.planner.arithmetic),
        "robot": settings.robot,
        "lidar": settings.lidar,
    }


def training_of(settings: Settings) -> Training:
    """What a policy of this run says of its origin."""
    meaning = {k: v for k, v in as_dict(settings).items() if k not in _PLACES}
    digest = hashlib.sha256(json.dumps(meaning, sort_keys=True).encode()).hexdigest()[:16]
    courses = tuple(course_of(world) for world in worlds_of(settings, settings.world.train))
    return Training(courses, settings.run.id, settings.run.seed, digest)


def check_not_trained_on(settings: Settings, methods: Iterable[tuple[str, str]]) -> None:
    """UserError: a policy would be evaluated on worlds that it was trained on, and nobody asked for that."""
    if settings.evaluation.training_worlds:
        return
    courses = {course_of(world): world.index for world in worlds_of(settings, settings.evaluation.worlds)}
    for label, spec in methods:
        path = Path(spec)
        training = PolicyFile.load(path).training if path.is_file() else None
        seen = [courses[course] for course in (training.courses if training else ()) if course in courses]
        if seen:
            raise UserError(
                f"evaluation.worlds: {label} was trained on {len(seen)} of these {len(courses)} worlds, {seen[0]} "
                "among them; choose others, or allow it with evaluation.training_worlds=true"
            )


def check_split(settings: Settings) -> None:
    """UserError: a run would be evaluated on worlds that it trains on, and nobody asked for that."""
    if settings.evaluation.training_worlds:
        return
    train = {course_of(world) for world in worlds_of(settings, settings.world.train)}
    both = [w.index for w in worlds_of(settings, settings.evaluation.worlds) if course_of(w) in train]
    if both:
        raise UserError(
            f"evaluation.worlds: {len(both)} of the worlds in {settings.evaluation.worlds!r} are among the training "
            f"worlds {settings.world.train!r}, {both[0]} is one; choose others, or allow it with "
            "evaluation.training_worlds=true"
        )


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
