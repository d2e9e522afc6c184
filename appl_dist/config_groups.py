"""Choices of the configuration groups: files of `conf/GROUP/`, and what the registries of `registry.py` hold.

`planner`, `robot`, `observation`, `reward` and `protocol` choose registered entries, those of a user's package too, as
in `protocol=challenge`; for them there is no file.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from hydra.core.config_store import ConfigStore

from appl_dist.actor.protocol import PROTOCOLS
from appl_dist.actor.reward import REWARDS
from appl_dist.planner.planners import PLANNERS
from appl_dist.policy.observation import OBSERVATIONS
from appl_dist.registry import Registry
from appl_dist.sim.robots import ROBOTS

_PACKAGE = Path(__file__).resolve().parent
CONF = next((p for p in (_PACKAGE / "conf", _PACKAGE.parent / "conf") if p.is_dir()), _PACKAGE / "conf")
REGISTRIES: dict[str, Registry[Any]] = {
    "planner": PLANNERS,
    "robot": ROBOTS,
    "observation": OBSERVATIONS,
    "reward": REWARDS,
    "protocol": PROTOCOLS,
}


def registered(group: str, name: str) -> dict[str, Any]:
    """What choosing `name` in the group of a registry sets. UserError lists the names."""
    entry = REGISTRIES[group].get(name)
    return dataclasses.asdict(entry) if group == "protocol" else {"name": name}


def store_choices(arguments: Iterable[str]) -> None:
    """Make the registries' choices known to Hydra. UserError: an argument `GROUP=NAME` with a name that nobody has."""
    for argument in arguments:
        group, equals, name = argument.partition("=")
        if equals and group in REGISTRIES:
            registered(group, name)  # an unknown name loads what users' packages add
    for group, registry in REGISTRIES.items():
        for name in registry.names():
            ConfigStore.instance().store(group=group, name=name, node=registered(group, name))


def choices(group: str) -> list[str]:
    """Names that a group may be set to, in alphabetical order."""
    files = {file.stem for file in (CONF / group).glob("*.yaml")}
    return sorted(files | set(REGISTRIES[group].names() if group in REGISTRIES else ()))


def groups() -> list[str]:
    """All groups, in alphabetical order."""
    return sorted({folder.name for folder in CONF.iterdir() if folder.is_dir()} | set(REGISTRIES))
