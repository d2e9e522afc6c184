"""Builds each role's parts from the settings and runs it. The learner imports torch; nothing else here does."""

from __future__ import annotations

import logging
import os
import signal
import socket
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from appl_dist.actor.env import NavigationEnv
from appl_dist.actor.main import Explorer, act, actor_seed
from appl_dist.actor.spool import Spool
from appl_dist.actor.worldset import select_worlds
from appl_dist.config import Settings, as_dict, from_dict
from appl_dist.errors import UserError
from appl_dist.launch.processes import die_with_parent
from appl_dist.sim.worlds import World
from appl_dist.spec import SPACES
from appl_dist.wire.bus import Bus
from appl_dist.wire.control import ControlClient, fetch_run
from appl_dist.wire.liveness import Presence
from appl_dist.wire.uploader import Uploader
from appl_dist.wire.weights import WeightsSubscriber

if TYPE_CHECKING:
    from appl_dist.learner.main import Learner

log = logging.getLogger(__name__)

DRAIN_S = 5.0  # an actor's last rollouts
LEARNER_AWAY_S = 60.0  # an actor waits this long for a learner that has not started yet
HELD_ROLLOUTS = 2  # an actor that the learner told to wait stops collecting at this many unsent rollouts


def environment_arguments(settings: Settings) -> dict[str, Any]:
    """Arguments of `NavigationEnv` beside the worlds and the protocol."""
    return {
        "decision_period_s": settings.env.decision_period_s,
        "space": SPACES[settings.env.space],
        "timing": settings.timing,
        "rewards": settings.reward,
        "planner": settings.planner,
        "robot": settings.robot,
        "lidar": settings.lidar,
    }


def worlds_of(settings: Settings, split: str) -> list[World]:
    return select_worlds(settings.world.path, settings.world.count, settings.world.seed, split)


def stop_event() -> threading.Event:
    """An event that SIGINT and SIGTERM set; a second SIGINT interrupts as usual."""
    event = threading.Event()

    def stop(number: int, _: object) -> None:
        if event.is_set() and number == signal.SIGINT:
            raise KeyboardInterrupt
        event.set()

    signal.signal(signal.SIGINT, stop)
    signal.signal(signal.SIGTERM, stop)
    return event


def learner(settings: Settings) -> int:
    """Run the learner alone until the run ends or a signal comes."""
    from appl_dist.wire.session import open_session

    die_with_parent()
    stop = stop_event()
    if not settings.wire.is_loopback and not settings.wire.users_file:
        log.warning(
            "%s: anyone who reaches this port can take part; wire.users_file restricts it", settings.wire.endpoint
        )
    with open_session(settings.wire, listen=True) as session:
        try:
            part = build_learner(settings, session)
            try:
                part.run(stop.is_set)
            finally:
                part.close()
        except OSError as error:
            raise UserError(
                f"run folder: cannot write {error.filename or ''} ({error.strerror}); what was acknowledged is kept, "
                "free some space and continue with run.resume"
            ) from None
    return 0


def build_learner(settings: Settings, bus: Bus) -> Learner:
    """The learner of `settings`, new or continued from its run folder. Raises UserError."""
    try:
        from appl_dist.learner.main import Learner, Run
    except ImportError as error:
        raise UserError(f"the learner needs torch: pip install 'appl-dist[learner]' ({error})") from None

    folder = Path(settings.run.resume or settings.run.folder or time.strftime("runs/%Y%m%d-%H%M%S"))
    if settings.run.resume and not (folder / "replay").is_dir():
        raise UserError(f"run.resume: {folder} is not the folder of a run; expected one that holds replay/")
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise UserError(f"run.folder: {folder} cannot be made: {error.strerror}") from None
    run = Run(
        run_id=folder.resolve().name,
        folder=folder,
        seed=settings.run.seed,
        transitions=settings.run.transitions,
        minutes=settings.run.minutes,
        config=as_dict(settings),
        space=SPACES[settings.env.space],
        failed_time_s=settings.protocol.failed_time_s,
        sigma=lambda n: settings.explore.sigma(n, settings.run.transitions),
    )
    return Learner(bus, run, settings.learner)


def actor(settings: Settings) -> int:
    """Run one actor until the learner ends the run or a signal comes; its configuration is the learner's."""
    from appl_dist.wire.session import open_session

    die_with_parent()
    stop = stop_event()
    with open_session(settings.wire, listen=False) as session:
        run_id, served = fetch_run(session, LEARNER_AWAY_S)
        frozen = from_dict(served)
        actor_id = settings.actor.id or f"actor-{socket.gethostname()}-{os.getpid()}"
        spool_folder = Path(settings.actor.spool or Path("spool") / run_id / actor_id)
        act_in_run(frozen, session, run_id, actor_id, spool_folder, stop.is_set)
    return 0


def act_in_run(
    settings: Settings,
    bus: Bus,
    run_id: str,
    actor_id: str,
    spool_folder: Path,
    stop: Callable[[], bool],
    between_episodes: Callable[[], bool] = lambda: False,
) -> int:
    """One actor's life on any bus; returns the transitions it made.

    between_episodes: asked before every episode; true holds the actor back for a moment.
    """
    env = NavigationEnv(
        worlds_of(settings, settings.world.train),
        protocol=settings.protocol,
        **environment_arguments(settings),
    )
    limit_bytes = settings.actor.spool_megabytes << 20
    with Spool(spool_folder, f"{run_id}/{actor_id}", settings.actor.spool_rollouts, limit_bytes) as spool:
        uploader = Uploader(bus, run_id, actor_id, spool)
        control = ControlClient(bus, run_id)
        weights = WeightsSubscriber(bus, run_id)
        presence = Presence(bus, run_id, "actor", actor_id)
        try:
            uploader.start(LEARNER_AWAY_S)
            seed = actor_seed(settings.run.seed, actor_id, spool.next_seq)
            explorer = Explorer(weights, env, settings.explore, settings.run.transitions, np.random.default_rng(seed))
            made = act(
                env,
                explorer,
                spool,
                seed=seed,
                stop=lambda: stop() or control.state() == "stop",
                beat=presence.beat,
                hold=lambda: between_episodes() or (uploader.held and len(spool) >= HELD_ROLLOUTS),
            )
            if not uploader.close(DRAIN_S):
                log.warning("%d rollouts stay in %s; the next start of this actor sends them", len(spool), spool_folder)
            return made
        finally:
            for part in (uploader, control, weights, presence, env):
                part.close()
