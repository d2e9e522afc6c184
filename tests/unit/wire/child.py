"""The processes that the wire's integration tests start, kill, freeze and restart.

    python -m tests.unit.wire.child receiver ENDPOINT FOLDER EPOCH
    python -m tests.unit.wire.child sender ENDPOINT FOLDER ACTOR COUNT

A sender puts rollouts until its spool has numbered COUNT of them, each tagged with its number, and exits 0
when all are acked, 2 with a sentence when refused. A receiver serves until killed.
"""

from __future__ import annotations

import sys
import threading
from pathlib import Path

from appl_dist.actor.spool import Spool
from appl_dist.errors import UserError
from appl_dist.learner.ingest import Ingest
from appl_dist.wire.codec import encode_rollout
from appl_dist.wire.control import ControlClient, ControlServer, fetch_run
from appl_dist.wire.liveness import Presence
from appl_dist.wire.run_status import Progress
from appl_dist.wire.session import open_session
from appl_dist.wire.upload import UploadServer
from appl_dist.wire.uploader import Uploader
from appl_dist.wire.wire_settings import WireSettings
from tests.unit.wire.support import FileStore, make_rollout

LEASE_S = 1.0


def receive(endpoint: str, folder: Path, epoch: int) -> None:
    with open_session(WireSettings(endpoint, lease_s=LEASE_S, timeout_s=4.0), listen=True) as session:
        store = FileStore(folder / "stored.txt")
        server = UploadServer(session, "run1", Ingest(store, None, "run1"), epoch=epoch, grace_s=LEASE_S)
        ControlServer(session, "run1", "{}", epoch=epoch, status=lambda: dict(server.counts))
        print("ready", flush=True)
        threading.Event().wait()


def send(endpoint: str, folder: Path, actor: str, count: int) -> None:
    with (
        open_session(WireSettings(endpoint, lease_s=LEASE_S, timeout_s=4.0), listen=False) as session,
        Spool(folder / actor, f"run1/{actor}", max_count=16) as spool,
    ):
        run_id, _ = fetch_run(session)
        control = ControlClient(session, run_id)
        presence = Presence(session, run_id, "actor", actor)
        uploader = Uploader(session, run_id, actor, spool, timeout_s=1.0)
        uploader.start()
        print("ready", flush=True)
        while spool.next_seq < count and control.state() == "run":
            spool.put(encode_rollout(make_rollout(spool.next_seq, transitions=20)))
            presence.beat(Progress(transitions=20 * spool.next_seq))
        stopped = control.state() == "stop"
        drained = uploader.close(drain_s=30.0)
        control.close()
        presence.close()
    if not drained and not stopped:
        sys.exit(f"{len(spool)} rollouts not acked; {dict(uploader.counts)}")


def main() -> None:
    role, endpoint, folder, *rest = sys.argv[1:]
    try:
        if role == "receiver":
            receive(endpoint, Path(folder), int(rest[0]))
        else:
            send(endpoint, Path(folder), rest[0], int(rest[1]))
    except UserError as error:
        print(error, file=sys.stderr)
        sys.exit(2)


if __name__ == "__main__":
    main()
