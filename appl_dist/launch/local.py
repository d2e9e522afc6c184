"""`appl-dist train`: a learner and its actors on this machine, watched, shown, stopped together; then an evaluation."""

from __future__ import annotations

import logging
import shlex
import signal
import sys
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

from rich.console import Console
from rich.live import Live

from appl_dist.config import CONFIG_FILE, Settings, cores
from appl_dist.errors import USER_ERROR, UserError
from appl_dist.evaluate.runner import make_methods
from appl_dist.evaluate.trials import TRIALS_FILE, Trial
from appl_dist.launch import view
from appl_dist.launch.environment import environment_arguments
from appl_dist.launch.evaluation import evaluate_methods, require_statistics
from appl_dist.launch.ledger import run_ledger
from appl_dist.launch.processes import Child, stop_all
from appl_dist.launch.roles import act_in_run, build_learner, open_spool, stop_event
from appl_dist.launch.runs import prepare, require_run
from appl_dist.overrides import quoted
from appl_dist.policy_file import PolicyFile
from appl_dist.wire.control import fetch_run, fetch_run_status
from appl_dist.wire.credentials import VIEWER
from appl_dist.wire.run_status import RunStatus

log = logging.getLogger(__name__)

POLL_S = 1.0
LOG_LINE_S = 10.0  # between lines where there is no terminal to draw on
CONNECT_S = 2.0
STOP_S = 20.0


def train(settings: Settings) -> int:
    """Run until the run's length is reached or Ctrl-C; status 0 also after Ctrl-C, which leaves a resumable folder."""
    require_statistics()
    settings, folder = prepare(settings)
    console = view.make_console()
    finished = _serial(settings) if settings.serial else _processes(settings, folder, console)
    ledger = run_ledger(folder)
    console.print(ledger.sentence(), highlight=False, markup=False, soft_wrap=True)
    if not ledger.agrees:
        return 1
    if not finished:
        console.print(
            f"stopped; continue with: appl-dist train {shlex.quote(f'run.resume={folder}')}",
            highlight=False,
            markup=False,
        )
        return 0
    _evaluate(settings, folder, console)
    return 0


def _processes(settings: Settings, folder: Path, console: Console) -> bool:
    """Whether the run reached its length."""
    logs = folder / "logs"
    logs.mkdir(exist_ok=True)
    config = f"--config={folder / CONFIG_FILE}"
    learner = Child("learner", ["learner", config], logs / "learner.log", signal.SIGINT)
    actors = [
        Child(
            f"actor-{i}",
            ["actor", config, f"actor.id=actor-{i}", quoted("actor.spool", str(folder / "spool" / f"actor-{i}"))],
            logs / f"actor-{i}.log",
        )
        for i in range(settings.actors or cores())
    ]
    children = [learner, *actors]
    stop = stop_event()
    try:
        for child in children:
            child.start()
        return _watch(settings, learner, children, stop.is_set, console)
    finally:
        for child in actors:  # they stop first: the learner still takes their last rollouts
            child.signal(signal.SIGTERM)
        for child in actors:
            child.wait(STOP_S / 2)
        stop_all(children, STOP_S)


def _watch(
    settings: Settings, learner: Child, children: list[Child], stop: Callable[[], bool], console: Console
) -> bool:
    """Show the run and restart what dies, until the learner ends (True) or `stop()` (False)."""
    from appl_dist.wire.session import open_session

    status: RunStatus | None = None
    session = run_id = None
    notes: list[str] = []
    next_line = 0.0
    live = Live(view.render(None, notes), console=console, refresh_per_second=2) if console.is_terminal else None
    if live:
        live.start()
    try:
        while not stop():
            time.sleep(POLL_S / 2)
            if learner.returncode() == 0:
                return True
            for child in children:
                # A process that has run before was right about its settings: what it meets now may pass.
                if child.returncode() == USER_ERROR and (child is learner or child.restarts == 0):
                    raise UserError(f"{child.name} stopped: {child.last_words().partition(': ')[2]}")
                before = child.restarts
                child.supervise()
                if child.restarts > before:
                    notes.append(f"{child.name} was restarted ({child.restarts}); see {child.log_file}")
            try:
                if session is None:
                    session = open_session(replace(settings.wire, timeout_s=CONNECT_S), False, VIEWER)
                if run_id is None:
                    found, _ = fetch_run(session, 1.0)
                    require_run(settings.run.id, found, settings.wire.connect_endpoint)
                    run_id = found
                status = fetch_run_status(session, run_id, 2.0)
            except UserError:
                continue  # starting, or restarting
            if live:
                live.update(view.render(status, notes, "Ctrl-C stops, resumable"))
            elif time.monotonic() >= next_line:
                next_line = time.monotonic() + LOG_LINE_S
                print(view.line(status), flush=True)
        return False
    finally:
        if live:
            live.stop()
        if session is not None:
            session.close()


def _serial(settings: Settings) -> bool:
    """The same graph in this process, one thing after another: an episode, then all the updates it allows."""
    from appl_dist.wire.memory import MemoryHub

    stop = stop_event()
    hub = MemoryHub()
    learner = build_learner(settings, hub.connect())
    run = learner.run_info
    limits = settings.actor

    def learn() -> bool:
        while learner.step():
            pass
        return False

    try:
        with open_spool(replace(limits, run=str(run.folder)), limits, run.run_id) as spool:
            act_in_run(settings, hub.connect(), run.run_id, spool, lambda: stop.is_set() or learner.finished, learn)
        learner.end()
        return learner.finished
    finally:
        learner.close()


def _evaluate(settings: Settings, folder: Path, console: Console) -> None:
    """The final policy against the configured methods on worlds that training did not see."""
    from appl_dist.learner.learner import POLICY_FILE

    policy = folder / POLICY_FILE
    methods = [*settings.evaluation.methods.items(), (_label(settings, folder / "evaluation", policy), str(policy))]
    evaluate_methods(settings, methods, folder / "evaluation", console, run=folder)
    sys.stdout.flush()


def _label(settings: Settings, evaluation: Path, policy: Path) -> str:
    """What the run's policy is called in its tables: "learned", or after a longer training "learned@TRANSITIONS".

    A run that was made longer has a new policy; the trials of the one before stay, under the name they have.
    """
    from appl_dist.evaluate.trial_log import read_rows

    log_file = evaluation / TRIALS_FILE
    rows = read_rows(log_file, Trial)[0] if log_file.exists() else []
    known = {row.policy for row in rows if row.method == "learned"}
    (method,) = make_methods([("learned", str(policy))], environment_arguments(settings))
    return "learned" if known <= {method.fingerprint} else f"learned@{PolicyFile.load(policy).transitions}"
