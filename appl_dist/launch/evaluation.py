"""Evaluate, replay and report from a configuration."""

from __future__ import annotations

import importlib.util
import logging
import signal
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

from rich.console import Console

from appl_dist.actor.world_split import all_worlds, select_worlds, split_groups
from appl_dist.config import Settings, as_dict, cores
from appl_dist.errors import UserError
from appl_dist.evaluate.workers import Crew
from appl_dist.launch.environment import check_environment, check_not_trained_on, environment_arguments
from appl_dist.launch.report_commands import open_env
from appl_dist.launch.runs import listen, make_folder, new_id
from appl_dist.launch.view import make_console

log = logging.getLogger(__name__)

DEFAULT_FOLDER = "runs/evaluation-%Y%m%d-%H%M%S"


def require_statistics() -> None:
    """UserError unless what the end of an evaluation needs can be imported: better now than after hours of trials."""
    if importlib.util.find_spec("scipy") is None:
        raise UserError(
            "the evaluation's statistics need scipy, which is not installed: pip install 'appl-dist[evaluate]' "
            "(or [learner], which has it too)"
        )


def evaluate(settings: Settings) -> int:
    """Compare the configured methods; prints tables, writes trials, tables, figures and the report."""
    require_statistics()
    check_environment(settings)
    named = settings.evaluation.folder
    folder = Path(named) if named else make_folder(Path(time.strftime(DEFAULT_FOLDER)), "evaluation.folder")
    with _terminable():
        try:
            evaluate_methods(settings, list(settings.evaluation.methods.items()), folder, make_console())
        except KeyboardInterrupt:
            log.warning("stopped; finished trials are kept, the same command with evaluation.folder=%s goes on", folder)
            return 130
    return 0


def evaluate_methods(
    settings: Settings, methods: Sequence[tuple[str, str]], folder: Path, console: Console, run: Path | None = None
) -> None:
    """Evaluate (label, policy) pairs under `settings` into `folder` and report. run: the training run it belongs to."""
    from appl_dist.evaluate.comparison import evaluate as run_evaluation

    check_not_trained_on(settings, methods)
    world = settings.world
    worlds = select_worlds(world.path, world.count, world.seed, settings.evaluation.worlds)
    everything = all_worlds(world.path, world.count, world.seed)
    with _workers(settings, folder) as workers:
        run_evaluation(
            methods,
            worlds,
            settings.evaluation.trials,
            folder,
            protocol=settings.protocol,
            environment=environment_arguments(settings),
            groups=split_groups(world.path, everything, [w.index for w in worlds]),
            workers=workers,
            seed=settings.run.seed,
            settings=as_dict(settings),
            console=console,
        )
    from appl_dist.report.build import print_tables, write_report

    report = write_report([run or folder], folder, open_env, pictures=settings.evaluation.report)
    print_tables(report, console)


@contextmanager
def _workers(settings: Settings, folder: Path) -> Iterator[int | Crew]:
    """Processes of this machine, or whatever actors come to the endpoint."""
    if not settings.evaluation.spread:
        yield settings.evaluation.workers or cores()
        return
    from appl_dist.launch.distributed_evaluation import SpreadCrew

    with listen(settings.wire) as session:
        log.info("trials wait for actors: appl-dist actors wire.endpoint=%s", settings.wire.endpoint)
        yield SpreadCrew(session, new_id(folder), settings)


@contextmanager
def _terminable() -> Iterator[None]:
    """SIGTERM ends as Ctrl-C does: workers stopped, the log whole."""

    def stop(number: int, frame: object) -> None:
        raise KeyboardInterrupt

    before = signal.signal(signal.SIGTERM, stop)
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, before)
