"""Where a run's processes go: the settings of `appl-dist launch`."""

from __future__ import annotations

import re
from dataclasses import dataclass

from appl_dist.errors import UserError
from appl_dist.wire.wire_settings import MAX_ACTORS

SYSTEMS = ("local", "slurm")
_TIME = re.compile(r"(\d+-)?\d{1,2}(:\d{2}){0,2}|\d+")
_WORD = re.compile(r"[A-Za-z0-9_.,:@+-]*")


@dataclass(frozen=True)
class LaunchSettings:
    """UserError naming the field that cannot be. What is "" or 0 is left to the cluster's own defaults.

    system: "local" (as `appl-dist train`) or "slurm". print_only: show what would be submitted, submit nothing.
    actors: how many in all (0: on this machine one per core). actors_per_task: how many share one job of the array.
    partition, account, time: as of sbatch; time is [days-]hours:minutes:seconds or minutes, of every job.
    learner_cpus, learner_memory_gb, actor_cpus, actor_memory_gb: of the learner, and of each actor.
    signal_s: this long before the time limit the learner writes a checkpoint, actors send what they have, and all
        jobs queue again.
    port: where the learner listens; 0 derives one from the job's number.
    activate: a script that makes `appl-dist` known, such as venv/bin/activate; "" uses this Python.
    container: an Apptainer image to run in. bind: folders it shall see besides the run's and the working one.
    extra, learner_extra, actor_extra: further options of sbatch, such as "--constraint=avx2", for all jobs or one kind.
    """

    system: str = "local"
    print_only: bool = False
    actors: int = 0
    actors_per_task: int = 1
    partition: str = ""
    account: str = ""
    time: str = "24:00:00"
    learner_cpus: int = 4
    learner_memory_gb: float = 0.0
    actor_cpus: int = 1
    actor_memory_gb: float = 0.0
    signal_s: int = 120
    port: int = 0
    activate: str = ""
    container: str = ""
    bind: tuple[str, ...] = ()
    extra: tuple[str, ...] = ()
    learner_extra: tuple[str, ...] = ()
    actor_extra: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        if self.system not in SYSTEMS:
            raise UserError(f"launch.system: got {self.system!r}; allowed {', '.join(SYSTEMS)}")
        for name, low, high in (
            ("actors", 0, MAX_ACTORS),
            ("actors_per_task", 1, 1024),
            ("learner_cpus", 1, 1024),
            ("actor_cpus", 1, 64),
            ("learner_memory_gb", 0, 100_000),
            ("actor_memory_gb", 0, 100_000),
            ("signal_s", 10, 3600),
            ("port", 0, 65535),
        ):
            value = getattr(self, name)
            if not low <= value <= high:
                raise UserError(f"launch.{name}: got {value}; allowed {low}..{high}")
        if self.system == "slurm" and self.actors < 1:
            raise UserError("launch.actors: got 0; a Slurm run needs at least 1, as in launch.actors=500")
        for name in ("partition", "account"):
            if not _WORD.fullmatch(getattr(self, name)):
                raise UserError(f"launch.{name}: got {getattr(self, name)!r}; expected a name")
        if not _TIME.fullmatch(self.time):
            raise UserError(f"launch.time: got {self.time!r}; expected [days-]hours:minutes:seconds, or minutes")
        if self.activate and self.container:
            raise UserError("launch.activate, launch.container: give one of them, a container brings its own Python")
        for name in ("extra", "learner_extra", "actor_extra"):
            for option in getattr(self, name):
                if not option.startswith("-") or "\n" in option:
                    raise UserError(
                        f"launch.{name}: got {option!r}; expected options of sbatch, as in --constraint=avx2"
                    )
