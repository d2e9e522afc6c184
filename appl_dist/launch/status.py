"""`appl-dist status`: what a run is doing, asked of its learner over the wire. Also what health checks call."""

from __future__ import annotations

import socket
from dataclasses import replace
from pathlib import Path

from appl_dist.config import Settings
from appl_dist.errors import UserError
from appl_dist.launch import view
from appl_dist.launch.runs import require_run, run_id_of, whereabouts, with_keys_of
from appl_dist.wire.control import fetch_run, fetch_run_status
from appl_dist.wire.credentials import VIEWER
from appl_dist.wire.run_status import RunStatus

ANSWER_S = 5.0
SILENT_S = 60.0  # a learner or an actor that has not moved for so long is not well
HERE = "--here"


def status(settings: Settings, here: bool = False) -> int:
    """Print the status of the run; UserError if nobody answers, or another run's learner, or the learner hangs.

    here: also if no actor of this host has been heard of lately.
    """
    from appl_dist.wire.session import open_session

    wire = with_keys_of(settings.actor.run, settings.wire)
    wire = replace(wire, timeout_s=min(settings.wire.timeout_s, ANSWER_S))
    if settings.actor.run:
        where = whereabouts(Path(settings.actor.run))
        if where.ended:
            raise UserError(f"the run in {settings.actor.run} has ended")
        wire = replace(wire, endpoint=where.endpoint or wire.endpoint)
    with open_session(wire, listen=False, identity=VIEWER) as session:
        run_id, _ = fetch_run(session, ANSWER_S)
        if settings.actor.run:
            require_run(run_id_of(Path(settings.actor.run)), run_id, wire.connect_endpoint)
        answer = fetch_run_status(session, run_id, ANSWER_S)
    check(answer, socket.gethostname() if here else "")
    console = view.make_console()
    console.print(view.render(answer, []))
    return 0


def check(status: RunStatus, host: str = "") -> None:
    """UserError if the learner hangs, or if no actor on `host` ("": any or none) has been heard of lately."""
    if status.age_s > SILENT_S:
        raise UserError(f"the learner of {status.run_id} answers, but has not moved for {status.age_s:.0f} s")
    lively = [actor for actor in status.actors if actor.silent_s <= SILENT_S]
    if host and not any(actor.host == host for actor in lively):
        raise UserError(f"no actor on {host} was heard of in the last {SILENT_S:.0f} s; {len(lively)} are elsewhere")
