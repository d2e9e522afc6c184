"""`appl-dist actors`: several actors on this machine for a learner elsewhere, supervised until the run ends."""

from __future__ import annotations

import json
import logging
import socket
import tempfile
import time
from dataclasses import replace
from pathlib import Path

from appl_dist.config import Settings, as_dict, cores
from appl_dist.launch.processes import Child, die_with_parent, stop_all
from appl_dist.launch.roles import stop_event
from appl_dist.launch.runs import Whereabouts, whereabouts

log = logging.getLogger(__name__)

POLL_S = 0.5
FIND_S = 5.0  # between looks at where the learner is
STOP_S = 20.0


def actors(settings: Settings) -> int:
    """Run `actors` actors until the learner ends the run or a signal comes; one that dies is started again.

    With `actor.run` they find the learner through the run's folder, wait for it, and follow it to another machine.
    Ids are `actor.id` (or this host's name) and a number.
    """
    die_with_parent()
    stop = stop_event()
    name = settings.actor.id or socket.gethostname()
    run = Path(settings.actor.run) if settings.actor.run else None
    logs = (run or Path()) / "logs"
    logs.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(prefix="appl-dist-") as private:  # 0700: the settings may hold a password
        crew = [Child(f"{name}-{i}", [], logs / f"{name}-{i}.log") for i in range(settings.actors or cores())]
        where = Whereabouts("", ended=False) if run else Whereabouts(settings.wire.endpoint, ended=False)
        started, look_at = "", 0.0
        try:
            while not stop.is_set():
                if run and time.monotonic() >= look_at:
                    look_at = time.monotonic() + FIND_S
                    where = whereabouts(run)
                if where.ended:
                    log.info("the run has ended")
                    return 0
                if where.endpoint and where.endpoint != started:
                    log.info("%d actors for the learner at %s", len(crew), where.endpoint)
                    stop_all(crew, STOP_S)
                    started = where.endpoint
                    for child in crew:
                        child.arguments = _arguments(settings, where.endpoint, child.name, Path(private))
                        child.start()
                for child in crew:
                    child.supervise()
                if started and all(child.returncode() == 0 for child in crew):
                    return 0
                stop.wait(POLL_S)
            return 0
        finally:
            stop_all(crew, STOP_S)


def _arguments(settings: Settings, endpoint: str, name: str, folder: Path) -> list[str]:
    own = replace(settings, wire=replace(settings.wire, endpoint=endpoint), actor=replace(settings.actor, id=name))
    file = folder / f"{name}.json"
    file.write_text(json.dumps(as_dict(own)))
    return ["actor", f"--config={file}"]
