"""`appl-dist actors`: several actors on this machine for a learner elsewhere, supervised until the run ends."""

from __future__ import annotations

import logging
import socket
import time
from dataclasses import asdict, replace
from pathlib import Path

from appl_dist.config import Settings, cores
from appl_dist.errors import UserError
from appl_dist.launch.processes import Child, die_with_parent, stop_all
from appl_dist.launch.roles import stop_event
from appl_dist.launch.runs import Whereabouts, whereabouts, with_keys_of
from appl_dist.overrides import quoted
from appl_dist.wire.credentials import ACTOR

log = logging.getLogger(__name__)

POLL_S = 0.5
FIND_S = 5.0  # between looks at where the learner is
STOP_S = 20.0


def actors(settings: Settings) -> int:
    """Run `actors` actors until the learner ends the run or a signal comes; one that dies is started again.

    With `actor.run` they find the learner through the run's folder, wait for it, and follow it to another machine.
    Ids are `actor.id` (or actor-HOST) and a number.
    """
    die_with_parent()
    stop = stop_event()
    name = settings.actor.id or f"{settings.wire.identity or ACTOR}-{socket.gethostname()}"
    run = Path(settings.actor.run) if settings.actor.run else None
    where = Whereabouts("" if run else settings.wire.endpoint, ended=False)
    logs = (run or Path()) / "logs"
    if run and run.exists() and not run.is_dir():
        raise UserError(f"actor.run: {run} is a file; it is a run's folder, as the learner has it (run.folder)")
    if run and not run.is_dir():
        log.info("waiting for the learner that makes %s", run)
    crew = [Child(f"{name}-{i}", [], logs / f"{name}-{i}.log") for i in range(settings.actors or cores())]
    started, look_at = "", 0.0
    try:
        while not stop.is_set():
            if run and time.monotonic() >= look_at:
                look_at = time.monotonic() + FIND_S
                where = whereabouts(run) if run.is_dir() else where
            if where.ended:
                log.info("the run has ended")
                return 0
            if where.endpoint and where.endpoint != started:
                log.info("%d actors for the learner at %s", len(crew), where.endpoint)
                stop_all(crew, STOP_S)
                started = where.endpoint
                logs.mkdir(parents=True, exist_ok=True)
                for child in crew:
                    child.arguments = _arguments(settings, where.endpoint, child.name)
                    child.start()
            for child in crew:
                child.supervise()
            if started and all(child.returncode() == 0 for child in crew):
                return 0
            stop.wait(POLL_S)
        return 0
    finally:
        stop_all(crew, STOP_S)


def _arguments(settings: Settings, endpoint: str, name: str) -> list[str]:
    """What tells an actor who it is and where its learner is; all else it gets from there."""
    wire = asdict(replace(with_keys_of(settings.actor.run, settings.wire), endpoint=endpoint))
    actor = {
        "id": name,
        "run": settings.actor.run,
        "spool": str(Path(settings.actor.spool) / name) if settings.actor.spool else "",
    }
    own = {**{f"wire.{k}": v for k, v in wire.items()}, **{f"actor.{k}": v for k, v in actor.items()}}
    own["run.id"] = settings.run.id
    return ["actor", *(quoted(key, value) for key, value in own.items())]
