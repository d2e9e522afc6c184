"""Builds each role's parts from the settings and runs it. The learner imports torch; nothing else here does."""

from __future__ import annotations

import logging
import os
import signal
import socket
import sys
import threading
import time
import zlib
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from appl_dist import seeds
from appl_dist.actor.collect import Explorer, act
from appl_dist.actor.env import NavigationEnv
from appl_dist.actor.orphans import HELD_S, OrphanSender
from appl_dist.actor.spool import Spool, SpoolInUse, has_rollouts
from appl_dist.config import ActorSettings, Settings, as_dict, from_dict
from appl_dist.errors import PassingFault, UserError
from appl_dist.files import explain
from appl_dist.launch.environment import (
    EVALUATION,
    environment_arguments,
    observation_of,
    space_of,
    training_of,
    worlds_of,
)
from appl_dist.launch.processes import die_with_parent
from appl_dist.launch.runs import (
    announce,
    announce_gone,
    listen,
    prepare,
    require_run,
    run_id_of,
    whereabouts,
    with_keys_of,
)
from appl_dist.wire.bus import Bus
from appl_dist.wire.control import ControlClient, fetch_run
from appl_dist.wire.credentials import ACTOR, find
from appl_dist.wire.liveness import Presence
from appl_dist.wire.typed import MAX_TEXT
from appl_dist.wire.uploader import Uploader
from appl_dist.wire.weights import WeightsSubscriber
from appl_dist.wire.wire_settings import MAX_ACTORS

if TYPE_CHECKING:
    from appl_dist.learner.learner import Learner

log = logging.getLogger(__name__)

DRAIN_S = 5.0  # an actor's last rollouts
LEARNER_AWAY_S = 60.0  # an actor waits this long for a learner that has not started yet
HELD_ROLLOUTS = 2  # an actor that the learner told to wait stops collecting at this many unsent rollouts


def stop_event(*signals: signal.Signals) -> threading.Event:
    """An event that `signals` (SIGINT and SIGTERM) set; a second SIGINT interrupts as usual."""
    event = threading.Event()

    def stop(number: int, _: object) -> None:
        if event.is_set() and number == signal.SIGINT:
            raise KeyboardInterrupt
        event.set()

    for number in signals or (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, stop)
    return event


def learner(settings: Settings) -> int:
    """Run the learner alone until the run ends or a signal comes; a run that `run.folder` holds is continued.

    SIGINT stops the run and all its actors. SIGTERM and SIGUSR1, by which a cluster takes a node away, end only this
    process: it writes a checkpoint, and the actors wait for the next learner.
    """
    die_with_parent()
    stop, leave = stop_event(signal.SIGINT), stop_event(signal.SIGTERM, signal.SIGUSR1)
    settings, folder = prepare(settings, or_continue=True)
    if not settings.wire.is_loopback and settings.wire.security == "none":
        log.warning(
            "wire.security=none: anyone who reaches %s can take part; without that setting the run makes and uses keys",
            settings.wire.endpoint,
        )
    with listen(settings.wire) as session:
        try:
            part = build_learner(settings, session)
            try:
                announce(folder, settings.wire.endpoint)
                ended = part.run(stop.is_set, leave.is_set)
                announce_gone(folder, ended)
            finally:
                part.close()
        except OSError as error:
            raise UserError(
                f"{error.filename or folder}: cannot be written: {explain(error)}; what was acknowledged is kept, "
                f"continue with run.resume={folder}"
            ) from None
    return 0


def build_learner(settings: Settings, bus: Bus) -> Learner:
    """The learner of `settings`, new or continued from its run folder, which `prepare` has made. Raises UserError."""
    try:
        from appl_dist.learner.learner import Learner
        from appl_dist.learner.run_info import Run
    except ImportError as error:
        raise UserError(f"the learner needs torch: pip install 'appl-dist[learner]' ({error})") from None

    folder = Path(settings.run.folder)
    run = Run(
        run_id=settings.run.id,
        folder=folder,
        seed=settings.run.seed,
        transitions=settings.run.transitions,
        minutes=settings.run.minutes,
        config=as_dict(settings),
        space=space_of(settings),
        failed_time_s=settings.protocol.failed_time_s,
        sigma=settings.explore.sigma,
        observation=observation_of(settings),
        sync=settings.run.sync,
        training=training_of(settings),
    )
    return Learner(bus, run, settings.learner)


def actor(settings: Settings) -> int:
    """Run one actor until the learner ends the run or a signal comes; its configuration is the learner's."""
    from appl_dist.wire.session import open_session

    die_with_parent()
    settings = replace(settings, wire=with_keys_of(settings.actor.run, settings.wire))
    own, (identity, may_be) = settings.actor, _who(settings)
    wire = settings.wire
    if own.run:
        where = whereabouts(Path(own.run))
        if where.ended:
            log.info("the run in %s has ended", own.run)
            return 0
        wire = replace(wire, endpoint=where.endpoint or wire.endpoint)
    # The first process of a container does not have the usual end by SIGTERM.
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(128 + signal.SIGTERM))
    with open_session(wire, listen=False, identity=identity) as session:
        run_id, served = fetch_run(session, LEARNER_AWAY_S)
        wanted = settings.run.id or (run_id_of(Path(own.run)) if own.run else run_id)
        require_run(wanted, run_id, wire.connect_endpoint)
        stop = stop_event()  # until here there is nothing to end in order
        if EVALUATION in served:
            from appl_dist.launch.distributed_evaluation import drive_trials

            drive_trials(session, run_id, served, own.id or f"{identity}-{os.getpid()}", stop.is_set)
            return 0
        frozen = from_dict(served)
        with (
            open_spool(own, frozen.actor, run_id, identity, frozen.run.sync) as spool,
            OrphanSender(session, run_id, spool_root(own, run_id), may_be, frozen.run.sync),
        ):
            act_in_run(frozen, session, run_id, spool, stop.is_set)
    return 0


def _who(settings: Settings) -> tuple[str, Callable[[str], bool]]:
    """(the name that this actor's id begins with, which ids its credentials cover). UserError: not its own id.

    Spools that do not lie in the run's folder belong to this host and working folder, and so do the names of their
    actors.
    """
    wire, own = settings.wire, settings.actor
    name, may_be = ACTOR, lambda actor_id: True
    if not wire.is_open:
        identity = find(wire.keys, wire.identity or own.id)
        name, may_be = identity.name, identity.covers
        if own.id and not may_be(own.id):
            raise UserError(f"actor.id: {own.id} is not covered by identity {name}; expected {name}-…")
    if not own.run:
        name = f"{name}-{socket.gethostname()[:30]}-{zlib.crc32(os.getcwd().encode()):08x}"
    return name, may_be


def spool_root(own: ActorSettings, run_id: str) -> Path:
    """The folder of a run's spools, as the actor that `own` describes sees it; its own is one of them."""
    if own.id and own.spool:
        return Path(own.spool).parent
    return Path(own.run) / "spool" if own.run else Path("spool") / run_id


def open_spool(
    own: ActorSettings, limits: ActorSettings, run_id: str, identity: str = ACTOR, sync: bool = False
) -> Spool:
    """The spool of the actor that `own` describes, as large as `limits` says; its owner's name is the actor's id.

    sync: see `RunSettings`. Without an id it is the first of IDENTITY-0, IDENTITY-1, … that no live process has; one
    whose rollouts wait comes first, so that a dead actor's spool is sent by its successor.
    """
    root = spool_root(own, run_id)
    if own.id:
        return _own_spool(Path(own.spool or root / own.id), own.id, limits, run_id, sync)
    names = [f"{identity}-{i}" for i in range(MAX_ACTORS)]
    waiting = {path.name for path in root.glob(f"{identity}-*") if has_rollouts(path)}
    for name in sorted(names, key=lambda n: n not in waiting):
        try:
            return _spool(root / name, name, limits, run_id, sync)
        except SpoolInUse:
            continue
    raise UserError(f"actor.id: all {MAX_ACTORS} names in {root} are in use; give this actor an id")


def _own_spool(folder: Path, actor_id: str, limits: ActorSettings, run_id: str, sync: bool) -> Spool:
    """The spool of this id, once another actor has sent what the last process of this id left in it."""
    deadline = time.monotonic() + 2.0 * HELD_S
    while True:
        try:
            return _spool(folder, actor_id, limits, run_id, sync)
        except SpoolInUse as error:
            if not error.passing or time.monotonic() > deadline:
                raise
        time.sleep(0.1)


def _spool(folder: Path, actor_id: str, limits: ActorSettings, run_id: str, sync: bool) -> Spool:
    return Spool(folder, f"{run_id}/{actor_id}", limits.spool_rollouts, limits.spool_megabytes << 20, sync=sync)


def act_in_run(
    settings: Settings,
    bus: Bus,
    run_id: str,
    spool: Spool,
    stop: Callable[[], bool],
    between_episodes: Callable[[], bool] = lambda: False,
) -> int:
    """The life of the actor whose spool this is, on any bus; returns the transitions it made.

    between_episodes: asked before every episode; true holds the actor back for a moment.
    """
    actor_id = spool.owner.rpartition("/")[2]
    env = NavigationEnv(
        worlds_of(settings, settings.world.train),
        protocol=settings.protocol,
        **environment_arguments(settings, settings.env.training_arithmetic),
    )
    uploader = Uploader(bus, run_id, actor_id, spool)
    control = ControlClient(bus, run_id)
    weights = WeightsSubscriber(bus, run_id)
    presence = Presence(bus, run_id, "actor", actor_id)
    host = socket.gethostname()[:MAX_TEXT]
    patience = Patience(lambda: control.learner_present, 60.0 * settings.actor.patience_min)
    try:
        uploader.start(LEARNER_AWAY_S, stop)
        life = (settings.run.seed, "actor", actor_id, spool.next_seq)  # another after a restart
        explorer = Explorer(weights, env, settings.explore, seeds.generator(*life, "exploration"))
        made = act(
            env,
            explorer,
            spool,
            seed=seeds.integer(*life, "environment"),
            stop=lambda: stop() or control.state() == "stop" or patience.is_over(),
            beat=lambda progress: presence.beat(replace(progress, host=host)),
            hold=lambda: between_episodes() or (uploader.held and len(spool) >= HELD_ROLLOUTS),
        )
        if not uploader.close(DRAIN_S):
            log.warning(
                "%d rollouts stay in %s; another actor of the run or the next start of this one sends them",
                len(spool),
                spool.folder,
            )
        if patience.is_over():
            raise PassingFault(f"no learner of run {run_id} for {settings.actor.patience_min:g} minutes")
        return made
    finally:
        for part in (uploader, control, weights, presence, env):
            part.close()


class Patience:
    """Whether something has been away for `limit_s` without a break."""

    def __init__(
        self, present: Callable[[], bool], limit_s: float, clock: Callable[[], float] = time.monotonic
    ) -> None:
        self._present, self._limit_s, self._clock = present, limit_s, clock
        self._seen_s = clock()

    def is_over(self) -> bool:
        now_s = self._clock()
        if self._present():
            self._seen_s = now_s
        return now_s - self._seen_s > self._limit_s
