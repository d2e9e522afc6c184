"""The configuration of every role: its schema, how it is composed, and the checks across fields.

The schema is the parts' own frozen settings dataclasses, so a default is written once, where it is used. Hydra composes
them with `conf/` and the command line; a wrong key, type or value becomes one sentence (UserError).
"""

from __future__ import annotations

import dataclasses
import json
import logging
import os
import re
import typing
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from hydra import compose, initialize_config_dir
from hydra.core.config_store import ConfigStore
from hydra.errors import HydraException
from omegaconf import OmegaConf
from omegaconf.errors import OmegaConfBaseException

from appl_dist import overrides
from appl_dist.actor.exploration import ExplorationSettings
from appl_dist.actor.protocol import Protocol
from appl_dist.actor.reward import RewardSettings
from appl_dist.actor.timing import TimingSettings
from appl_dist.config_groups import CONF, REGISTRIES, registered, store_choices
from appl_dist.config_schema import build, schema_of, sentence
from appl_dist.errors import UserError
from appl_dist.launch.launch_settings import LaunchSettings
from appl_dist.learner.settings import LearnerSettings
from appl_dist.planner.planner_settings import Arithmetic, PlannerSettings
from appl_dist.planner.planners import PLANNERS
from appl_dist.policy.observation import ObservationSettings
from appl_dist.sim.simulator import LidarSettings, RobotSettings
from appl_dist.wire.wire_settings import MAX_ACTORS, WireSettings

log = logging.getLogger(__name__)
CONFIG_OPTION = "--config="
CONFIG_FILE = "config.json"  # in a run's folder
# What a continued run may change: its length, where it runs, and whatever leaves the meaning of its data alone.
CHANGEABLE = (
    "run.transitions", "run.minutes", "run.resume", "actors", "serial", "wire", "launch", "evaluation", "actor",
    *(f"learner.td3.{name}" for name in (
        "batch_size", "actor_lr", "critic_lr", "polyak", "target_noise", "target_noise_clip", "policy_delay",
        "precision", "device", "threads")),
    *(f"learner.{name}" for name in (
        "samples_per_insert", "samples_tolerance", "publish_every_s", "report_every_s", "checkpoint_every_s",
        "detail_every")),
)  # fmt: skip


@dataclass(frozen=True)
class RunSettings:
    """folder: "" makes runs/<date>-<time>; resume: an earlier run's folder to continue, with its configuration.

    id: the run's random name on the wire, drawn when its folder is made.
    The run ends at `transitions`, or after `minutes` of wall-clock if that comes first (0: no such limit).
    sync: every rollout is on the disk, not only with the kernel, before it is sent and again before it is acknowledged:
        then a power cut loses none.
    """

    folder: str = ""
    resume: str = ""
    id: str = ""
    seed: int = 0
    transitions: int = 50_000
    minutes: float = 0.0
    sync: bool = False


@dataclass(frozen=True)
class WorldSettings:
    """path: "" generates worlds; else a folder, tarball or npz of BARN worlds. train, test: which worlds.

    A split is "train", "test" (the 250 / 50 of APPLR), "all", or indices and ranges: "0:50", "0:300:6", "'0,6,12'".
    """

    path: str = ""
    count: int = 300
    seed: int = 0
    train: str = "train"
    test: str = "test"


@dataclass(frozen=True)
class EnvSettings:
    """How the planner is tuned, and which arithmetic it has while the policy is trained.

    decision_period_s: how often the policy acts; space: which of the planner's parameter boxes ("dwa" or "dwa_wide").
    training_arithmetic: planner.arithmetic of actors that collect transitions. "fast" collects twice as many; paired
        episodes cannot tell it from "exact" (benchmarks/README.md). Evaluations drive with planner.arithmetic.
    """

    decision_period_s: float = 2.0
    space: str = "dwa"
    training_arithmetic: Arithmetic = "fast"

    def __post_init__(self) -> None:
        _one_of("env.training_arithmetic", self.training_arithmetic, typing.get_args(Arithmetic))


@dataclass(frozen=True)
class ActorSettings:
    """Who an actor is and where it keeps unsent rollouts.

    run: the run's folder, if this machine sees it: there the actor finds the learner's address and its spool, and
        without an id takes the first of actor-0, actor-1, … that no live process has.
    id: "" otherwise takes actor-<host>-<pid>. spool: "" is spool/<id> in the run's folder, or ./spool/<run>/<id>.
    patience_min: an actor that has heard of no learner for so long ends, min; what is in its spool stays.
    """

    run: str = ""
    id: str = ""
    spool: str = ""
    spool_rollouts: int = 1000
    spool_megabytes: int = 256
    patience_min: float = 60.0


@dataclass(frozen=True)
class EvaluationSettings:
    """methods: policies by label; a policy is "default", a policy file, "set:name=value,…" or a published set.

    worlds: a split, as in `world`. workers: 0 takes one per core. spread: instead hand the trials to the actors that
    connect to wire.endpoint, on this machine or others. report: besides tables, draw figures and write the page.
    training_worlds: allow worlds that a policy was trained on.
    """

    methods: dict[str, str] = field(default_factory=dict)
    worlds: str = "test"
    trials: int = 10
    workers: int = 0
    spread: bool = False
    report: bool = True
    training_worlds: bool = False
    folder: str = ""


@dataclass(frozen=True)
class Settings:
    """Everything, checked. actors: 0 takes one per core."""

    run: RunSettings
    actors: int
    serial: bool
    world: WorldSettings
    robot: RobotSettings
    lidar: LidarSettings
    timing: TimingSettings
    planner: PlannerSettings
    observation: ObservationSettings
    protocol: Protocol
    env: EnvSettings
    reward: RewardSettings
    explore: ExplorationSettings
    actor: ActorSettings
    learner: LearnerSettings
    wire: WireSettings
    evaluation: EvaluationSettings
    launch: LaunchSettings

    def __post_init__(self) -> None:
        _allowed("run.transitions", self.run.transitions, 1, 10**10)
        _allowed("run.minutes", self.run.minutes, 0, 10**6)
        _allowed("run.seed", self.run.seed, 0, 2**31 - 1)
        _allowed("actors", self.actors, 0, MAX_ACTORS)
        _allowed("world.count", self.world.count, 1, 100_000)
        _allowed("world.seed", self.world.seed, 0, 2**63 - 1)
        _allowed("env.decision_period_s", self.env.decision_period_s, 0.1, 60.0)
        _allowed("actor.spool_rollouts", self.actor.spool_rollouts, 1, 10**6)
        _allowed("actor.spool_megabytes", self.actor.spool_megabytes, 1, 10**6)
        _allowed("actor.patience_min", self.actor.patience_min, 0.1, 10**6)
        _allowed("evaluation.trials", self.evaluation.trials, 1, 10_000)
        _allowed("evaluation.workers", self.evaluation.workers, 0, 1024)
        if not self.evaluation.methods:
            raise ValueError("evaluation.methods: got none; expected at least one, as in +evaluation.methods.mine=FILE")
        for group in ("planner", "robot", "observation", "reward"):
            registered(group, getattr(self, group).name)
        PLANNERS.get(self.planner.name).space(self.env.space)
        if self.actor.id and not re.fullmatch(r"[A-Za-z0-9_.-]{1,64}", self.actor.id):
            raise ValueError(f"actor.id: got {self.actor.id!r}; allowed 1 to 64 of letters, digits, '_', '.', '-'")


def load(arguments: Sequence[str]) -> Settings:
    """Settings of conf/config.yaml with command-line overrides; of a frozen `--config=FILE` with overrides; or, with
    `run.resume=FOLDER`, of that run with those overrides that a continued run may change. Raises UserError.
    """
    files = [o.removeprefix(CONFIG_OPTION) for o in arguments if o.startswith(CONFIG_OPTION)]
    rest = [o for o in arguments if not o.startswith(CONFIG_OPTION)]
    if files:
        return from_dict(_with_overrides(read_frozen(Path(files[-1]), "--config"), rest))
    plain = compose_dict(rest)
    resume = plain["run"]["resume"]
    return load_continued(Path(resume), rest) if resume else from_dict(plain)


def load_continued(folder: Path, arguments: Sequence[str] = ()) -> Settings:
    """The configuration frozen in a run's folder, changed by `arguments`. UserError: a key that has to stay."""
    frozen = read_frozen(folder / CONFIG_FILE, "run.resume")
    frozen["run"]["resume"] = str(folder)
    given = compose_dict(arguments)
    for argument in arguments:
        key = argument.lstrip("~+").partition("=")[0]
        *groups, last = overrides.path(Settings, key)
        now, then = given, frozen
        for group in groups:
            now, then = now[group], then.setdefault(group, {})
        value = now.get(last)
        if any(key == name or key.startswith(f"{name}.") for name in CHANGEABLE):
            then[last] = value
            if argument.startswith("~"):
                del then[last]
        elif value != then.get(last):
            raise UserError(
                f"{key}: got {value!r}, the run in {folder} has {then.get(last)!r}; a continued run may change only "
                f"{', '.join(CHANGEABLE)}; start a new one with learner.init={folder} to change more"
            )
    return from_dict(frozen)


def read_frozen(file: Path, what: str) -> dict[str, Any]:
    """The configuration in a JSON file; UserError naming `what` asked for it."""
    try:
        frozen = json.loads(file.read_text("utf-8"))
    except OSError as error:
        raise UserError(f"{what}: {file} cannot be read: {error.strerror}") from None
    except ValueError as error:
        raise UserError(f"{what}: {file} is damaged: {error}") from None
    if not isinstance(frozen, dict) or not isinstance(frozen.get("run"), dict):
        raise UserError(f"{what}: {file} is damaged: it holds no configuration of a run")
    return frozen


def _with_overrides(frozen: dict[str, Any], arguments: Sequence[str]) -> dict[str, Any]:
    texts, others = overrides.split(arguments, Settings)
    try:
        merged = OmegaConf.to_container(OmegaConf.merge(frozen, OmegaConf.from_dotlist(others)))
    except (OmegaConfBaseException, ValueError) as error:
        raise UserError(sentence(error)) from None
    return _assigned(merged, texts)


def _assigned(composed: Any, texts: Sequence[tuple[str, overrides.Text]]) -> dict[str, Any]:
    plain: dict[str, Any] = composed
    for key, text in texts:
        overrides.assign(plain, key, text, Settings)
    return plain


def compose_dict(arguments: Sequence[str]) -> dict[str, Any]:
    """The composed configuration as plain values: what a run freezes and the learner serves."""
    ConfigStore.instance().store(name="schema", node=schema_of(Settings))
    store_choices(arguments)
    texts, others = overrides.split(arguments, Settings)
    try:
        with initialize_config_dir(str(CONF), version_base="1.3"):
            node = compose("config", overrides=others)
        plain = OmegaConf.to_container(node, resolve=True)
    except (HydraException, OmegaConfBaseException) as error:
        raise UserError(sentence(error)) from None
    return _assigned(plain, texts)


def from_dict(plain: dict[str, Any]) -> Settings:
    """Settings of a composed or received configuration, every field checked. Raises UserError.

    The group of a registry may be a name, as in `--config=FILE protocol=challenge`; its other keys are then default.
    """
    try:
        for group in REGISTRIES:
            if isinstance(plain.get(group), str):
                plain = plain | {group: registered(group, plain[group])}
        node = OmegaConf.merge(OmegaConf.structured(schema_of(Settings)), plain)
        checked: Any = OmegaConf.to_container(node, resolve=True)
        return build(Settings, checked)
    except (OmegaConfBaseException, ValueError, TypeError) as error:
        raise UserError(sentence(error)) from None


def as_dict(settings: Settings) -> dict[str, Any]:
    """Plain values of `settings`, such that from_dict(as_dict(s)) == s."""
    return dataclasses.asdict(settings)


def cores() -> int:
    """Processor cores this process may use."""
    return len(os.sched_getaffinity(0))


def _allowed(name: str, value: float, low: float, high: float) -> None:
    if not low <= value <= high:
        raise ValueError(f"{name}: got {value}; allowed {low:g}..{high:g}")


def _one_of(name: str, value: str, allowed: Any) -> None:
    if value not in allowed:
        raise ValueError(f"{name}: got {value!r}; allowed {', '.join(sorted(allowed))}")
