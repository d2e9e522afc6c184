"""A run's folder: made or found, its configuration frozen in it, and in it where the run's learner is."""

from __future__ import annotations

import json
import socket
import time
from dataclasses import dataclass, replace
from pathlib import Path

from appl_dist.config import CONFIG_FILE, Settings, as_dict, load
from appl_dist.errors import UserError
from appl_dist.files import write_atomic
from appl_dist.launch.environment import worlds_of
from appl_dist.wire.key_expressions import is_name

LEARNER_FILE = "learner.json"
_EVERYWHERE = ("0.0.0.0", "[::]")


def run_folder(settings: Settings) -> Path:
    """Where the run lies, or will."""
    return Path(settings.run.resume or settings.run.folder or time.strftime("runs/%Y%m%d-%H%M%S"))


def prepare(settings: Settings, or_continue: bool = False) -> tuple[Settings, Path]:
    """Make or find the run folder and freeze the configuration in it.

    or_continue: whether `run.folder` may name a run that exists; it goes on with its own configuration, except for
    its length, the wire and where it runs. (`run.resume` has its configuration from `config.load`.)
    """
    folder = run_folder(settings)
    if not is_name(folder.resolve().name):  # it is the run's id on the wire
        raise UserError(
            f"run.folder: got {folder}; its last part names the run: allowed 1..64 of A-Z a-z 0-9 _ . - "
            "(letter or digit first)"
        )
    exists = (folder / CONFIG_FILE).exists()
    if or_continue and exists:
        frozen = load([f"run.resume={folder}"])
        run = replace(frozen.run, transitions=settings.run.transitions, minutes=settings.run.minutes)
        settings = replace(frozen, run=run, wire=settings.wire, launch=settings.launch)
    elif exists and not settings.run.resume:
        raise UserError(f"run.folder: {folder} already holds a run; continue it with run.resume={folder}")
    settings = replace(settings, run=replace(settings.run, folder=str(folder), resume=""))
    if not exists:
        worlds_of(settings, settings.world.train)  # a wrong path is told here, not by every actor
        worlds_of(settings, settings.evaluation.worlds)
    write_atomic(folder / CONFIG_FILE, json.dumps(as_dict(settings), indent=2), sync=True)
    return settings, folder


@dataclass(frozen=True)
class Whereabouts:
    """Where a run's learner is, "" while it is nowhere; `ended`: the run is over and no learner will come."""

    endpoint: str
    ended: bool


def announce(folder: Path, endpoint: str) -> None:
    """Write down that the learner listens on `endpoint`; an address of every interface becomes this host's name."""
    scheme, _, rest = endpoint.partition("/")
    host, _, port = rest.rpartition(":")
    if host in _EVERYWHERE:
        endpoint = f"{scheme}/{socket.gethostname()}:{port}"
    _write(folder, Whereabouts(endpoint, ended=False))


def announce_gone(folder: Path, ended: bool) -> None:
    """Write down that there is no learner now, and whether there will be another."""
    _write(folder, Whereabouts("", ended))


def whereabouts(folder: Path) -> Whereabouts:
    """What was written down last; no endpoint if nothing was. UserError: there is no such folder."""
    if not folder.is_dir():
        raise UserError(f"actor.run: no folder at {folder}; it is a run's, as the learner has it (run.folder)")
    try:
        values = json.loads((folder / LEARNER_FILE).read_text())
        return Whereabouts(str(values["endpoint"]), bool(values["ended"]))
    except FileNotFoundError:
        return Whereabouts("", ended=False)
    except (OSError, ValueError, TypeError, KeyError) as error:
        raise UserError(f"{folder / LEARNER_FILE}: cannot be read ({error})") from None


def require_run(folder: Path, run_id: str) -> None:
    """UserError if the learner that answered has another run than the one in `folder`.

    An address written down long ago, or the default one, may be another run's by now.
    """
    if run_id != folder.resolve().name:
        raise UserError(f"no learner of the run in {folder}: the one that answers has run {run_id}")


def _write(folder: Path, where: Whereabouts) -> None:
    write_atomic(folder / LEARNER_FILE, json.dumps({"endpoint": where.endpoint, "ended": where.ended}))
