"""A run's folder: made or found, its configuration frozen in it, and in it where the run's learner is."""

from __future__ import annotations

import itertools
import json
import logging
import re
import secrets
import socket
import time
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

from appl_dist.config import CONFIG_FILE, Settings, as_dict, load_continued, read_frozen
from appl_dist.errors import UserError
from appl_dist.files import explain, write_atomic, write_new
from appl_dist.launch.environment import check_environment, check_split
from appl_dist.launch.make_keys import make_keys
from appl_dist.wire.control import fetch_run
from appl_dist.wire.credentials import ACTOR, VIEWER
from appl_dist.wire.key_expressions import is_name
from appl_dist.wire.wire_settings import WireSettings

if TYPE_CHECKING:
    from appl_dist.wire.session import Session

log = logging.getLogger(__name__)

LEARNER_FILE = "learner.json"
KEYS_FOLDER = "keys"  # in a run's folder
DEFAULT_FOLDER = "runs/%Y%m%d-%H%M%S"
ASK_S = 2.0  # to reach who holds an endpoint
STARTING_S = 20.0  # a learner that holds one imports torch and makes its replay before it answers
_OUTPUTS = ("checkpoints", "replay", "spool", "evaluation", "policy.safetensors", "metrics.jsonl", "epoch.json")
_EVERYWHERE = ("0.0.0.0", "[::]")


def run_folder(settings: Settings) -> Path:
    """Where the run lies, or will unless another takes the name first."""
    return Path(settings.run.resume or settings.run.folder or time.strftime(DEFAULT_FOLDER))


def prepare(settings: Settings, or_continue: bool = False) -> tuple[Settings, Path]:
    """Make or find the run folder and freeze the configuration in it.

    or_continue: whether `run.folder` may name a run that exists; it goes on with its own configuration, except for
    its length, the wire and where it runs. (`run.resume` has its configuration from `config.load`.)
    """
    folder = run_folder(settings)
    if settings.run.resume:
        return _freeze(replace(settings, wire=_with_own_keys(settings.wire, folder)), folder), folder
    if or_continue and (folder / CONFIG_FILE).exists():
        frozen = load_continued(folder)
        run = replace(frozen.run, transitions=settings.run.transitions, minutes=settings.run.minutes)
        wire = _with_own_keys(settings.wire, folder)
        return _freeze(replace(frozen, run=run, wire=wire, launch=settings.launch), folder), folder
    check_environment(settings)  # before there is a folder: a mistake leaves nothing behind
    check_split(settings)
    return _create(settings, folder)


def _create(settings: Settings, folder: Path) -> tuple[Settings, Path]:
    """A new run: whoever makes its configuration file owns the folder."""
    if settings.run.folder:
        _made(folder, "run.folder", exist_ok=True)
        found = [name for name in _OUTPUTS if (folder / name).exists()]
        if found and not (folder / CONFIG_FILE).exists():
            raise UserError(f"run.folder: {folder} holds {found[0]}, which a run would overwrite; choose a new folder")
    else:
        folder = make_folder(folder, "run.folder")
    run = replace(settings.run, folder=str(folder), id=new_id(folder))
    horizon = settings.explore.horizon or run.transitions
    wire = _with_own_keys(settings.wire, folder)
    fresh = replace(settings, run=run, wire=wire, explore=replace(settings.explore, horizon=horizon))
    if not write_new(folder / CONFIG_FILE, json.dumps(as_dict(fresh), indent=2)):
        raise UserError(f"run.folder: {folder} already holds a run; continue it with run.resume={folder}")
    return fresh, folder


def _with_own_keys(wire: WireSettings, folder: Path) -> WireSettings:
    """What a run uses: beyond loopback, and unless told otherwise, keys of its own, which are made here."""
    if wire.security != "auto" or wire.is_loopback:
        return wire
    keys = folder / KEYS_FOLDER
    if not keys.is_dir():
        make_keys(keys, [], [])
    log.info("keys of this run are in %s; an actor elsewhere needs %s/%s: wire.keys=FOLDER", keys, keys, ACTOR)
    return replace(wire, security="password", keys=str(keys))


def with_keys_of(run: str, wire: WireSettings) -> WireSettings:
    """The wire of a process that sees the run's folder ("": none): with that run's own keys, if it made any."""
    keys = Path(run) / KEYS_FOLDER
    if not run or wire.security != "auto" or not keys.is_dir():
        return wire
    return replace(wire, security="password", keys=str(keys))


def make_folder(folder: Path, key: str) -> Path:
    """A new folder of this name, or with -2, -3, … behind it where others have taken the name. key: of its setting."""
    name = folder.name
    for number in itertools.count(2):
        if _made(folder, key, exist_ok=False):
            return folder
        folder = folder.with_name(f"{name}-{number}")
    raise AssertionError("unreachable")


def _made(folder: Path, key: str, exist_ok: bool) -> bool:
    try:
        folder.parent.mkdir(parents=True, exist_ok=True)
        try:
            folder.mkdir(exist_ok=exist_ok)
        except FileExistsError:
            if exist_ok:
                raise
            return False
    except OSError as error:
        raise UserError(f"{key}: {folder} cannot be made: {explain(error)}") from None
    return True


def _freeze(settings: Settings, folder: Path) -> Settings:
    """The settings of a run that exists, written down again with what was changed."""
    settings = replace(settings, run=replace(settings.run, folder=str(folder), resume=""))
    write_atomic(folder / CONFIG_FILE, json.dumps(as_dict(settings), indent=2), sync=True)
    return settings


def new_id(folder: Path) -> str:
    """A random name for a run or an evaluation on the wire, with its folder's name for people to read."""
    readable = re.sub(r"[^A-Za-z0-9_.-]", "-", folder.resolve().name)[:40].lstrip("._-")
    return f"{readable or 'run'}-{secrets.token_hex(8)}"


def run_id_of(folder: Path) -> str:
    """The random name of the run in `folder`."""
    run_id = read_frozen(folder / CONFIG_FILE, "actor.run")["run"].get("id")
    if not is_name(run_id):
        raise UserError(f"actor.run: {folder / CONFIG_FILE} is damaged: run.id is {run_id!r}")
    return str(run_id)


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
        values = json.loads((folder / LEARNER_FILE).read_text("utf-8"))
        return Whereabouts(str(values["endpoint"]), bool(values["ended"]))
    except FileNotFoundError:
        return Whereabouts("", ended=False)
    except (OSError, ValueError, TypeError, KeyError) as error:
        raise UserError(f"{folder / LEARNER_FILE}: cannot be read ({error})") from None


def require_run(wanted: str, run_id: str, endpoint: str) -> None:
    """UserError if the learner that answered has another run than `wanted`, the random name of the caller's.

    An address written down long ago, or the default one, may be another run's by now.
    """
    if run_id != wanted:
        raise UserError(
            f"wire.endpoint: the learner at {endpoint} has run {run_id}, not {wanted}; "
            "give each run a port of its own, as in wire.endpoint=tcp/127.0.0.1:7448"
        )


def listen(wire: WireSettings) -> Session:
    """A session that listens on the endpoint. UserError: another process does, named if it is a run's learner."""
    from appl_dist.wire.session import EndpointInUse, open_session

    try:
        return open_session(wire, listen=True)
    except EndpointInUse as taken:
        try:
            with open_session(replace(wire, timeout_s=ASK_S), listen=False, identity=VIEWER) as session:
                owner, _ = fetch_run(session, STARTING_S)
        except UserError:
            raise taken from None
        raise EndpointInUse(str(taken).replace("another process", f"run {owner}")) from None


def _write(folder: Path, where: Whereabouts) -> None:
    write_atomic(folder / LEARNER_FILE, json.dumps({"endpoint": where.endpoint, "ended": where.ended}))
