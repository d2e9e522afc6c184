"""Rollouts that dead actors left in a run's spool folder, sent by an actor that lives.

Input: the folder of a run's spools. Output: uploads of each spool that no process has locked, under the id of the actor
that made them. The learner expects the numbers of that id, so each rollout is still stored exactly once.
"""

from __future__ import annotations

import logging
import random
import threading
import time
from collections.abc import Callable
from pathlib import Path

from appl_dist.actor.spool import Spool, SpoolInUse, has_rollouts, owner_of
from appl_dist.errors import UserError
from appl_dist.wire.bus import Bus
from appl_dist.wire.uploader import Uploader

log = logging.getLogger(__name__)

EVERY_S = 60.0  # between looks, on average
MOST_FOLDERS = 20  # of one look, drawn at random: thousands of actors must not list thousands of folders each
HELD_S = 30.0  # the longest time a spool is kept locked: its own actor may be starting again


class OrphanSender:
    """A thread that sends the orphaned spools in `root` on `bus`, from `start` to `close`; also a context manager.

    may_send: whether the credentials of this process cover an actor id. sync: see `Spool`.
    """

    def __init__(
        self,
        bus: Bus,
        run_id: str,
        root: Path,
        may_send: Callable[[str], bool] = lambda actor_id: True,
        sync: bool = False,
    ) -> None:
        self._bus, self._run_id, self._root = bus, run_id, root
        self._may_send, self._sync = may_send, sync
        self._random = random.Random(bus.identity)  # not those of training: only when and where it looks
        self._told: set[str] = set()
        self._closing = threading.Event()
        self._thread = threading.Thread(target=self._run, name="orphans", daemon=True)

    def start(self) -> None:
        self._thread.start()

    def close(self) -> None:
        """Stop; waits for the answer to an upload that is under way."""
        self._closing.set()
        if self._thread.is_alive():
            self._thread.join(timeout=10.0)

    def __enter__(self) -> OrphanSender:
        self.start()
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def sweep(self) -> int:
        """Look once, at MOST_FOLDERS of the spools at most; returns how many rollouts the learner has now."""
        folders = sorted(path for path in self._root.iterdir() if path.is_dir()) if self._root.is_dir() else []
        chosen = self._random.sample(folders, min(MOST_FOLDERS, len(folders)))
        return sum(self._send(folder) for folder in chosen if not self._closing.is_set())

    def _run(self) -> None:
        while not self._closing.wait(EVERY_S * self._random.uniform(0.5, 1.5)):
            try:
                self.sweep()
            except Exception:  # the actor's own work must go on
                log.exception("looking for spools of dead actors failed")

    def _send(self, folder: Path) -> int:
        if not has_rollouts(folder):
            return 0
        try:
            run_id, _, actor_id = owner_of(folder).rpartition("/")
            if run_id != self._run_id or not self._may_send(actor_id):
                return 0
            with Spool(folder, f"{run_id}/{actor_id}", sync=self._sync, passing=True) as spool:
                return self._upload(spool, actor_id)
        except SpoolInUse:
            return 0
        except (UserError, ValueError) as error:
            if str(error) not in self._told:
                self._told.add(str(error))
                log.warning("%s: what is in it cannot be sent: %s", folder, error)
            return 0

    def _upload(self, spool: Spool, actor_id: str) -> int:
        before, deadline = len(spool), time.monotonic() + HELD_S
        uploader = Uploader(self._bus, self._run_id, actor_id, spool)
        try:
            while len(spool) and not uploader.refused and time.monotonic() < deadline:
                if self._closing.wait(uploader.step()):
                    break
        finally:
            uploader.close()
        sent = before - len(spool)
        rest = f"; {len(spool)} stay: {uploader.refused or 'the learner does not take them now'}" if len(spool) else ""
        log.info("sent %d rollouts that actor %s left in %s%s", sent, actor_id, spool.folder, rest)
        return sent
