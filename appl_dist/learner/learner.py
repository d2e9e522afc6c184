"""The learner process: takes rollouts in, trains, sends policies out, keeps what a restart needs.

In: rollouts over the wire. Out: policies over the wire; in the run folder `policy.safetensors` (the newest),
`checkpoints/`, `replay/`, `metrics.jsonl` and TensorBoard scalars.
"""

from __future__ import annotations

import json
import logging
import math
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np

from appl_dist import seeds
from appl_dist.errors import UserError
from appl_dist.files import write_atomic
from appl_dist.learner.checkpoint import Checkpoints
from appl_dist.learner.episodes import EpisodeStatistics
from appl_dist.learner.ingest import Ingest
from appl_dist.learner.initial import initialise
from appl_dist.learner.limiter import RateLimiter
from appl_dist.learner.replay import Replay
from appl_dist.learner.run_info import Run
from appl_dist.learner.settings import LearnerSettings
from appl_dist.learner.td3 import TD3, Diverged, read
from appl_dist.learner.telemetry import Telemetry
from appl_dist.policy_file import PolicyFile
from appl_dist.spec import Rollout
from appl_dist.wire.bus import Bus
from appl_dist.wire.codec import Ack, UploadHeader
from appl_dist.wire.control import ControlServer
from appl_dist.wire.liveness import Roster
from appl_dist.wire.upload import UploadServer
from appl_dist.wire.weights import WeightsPublisher

log = logging.getLogger(__name__)

POLICY_FILE = "policy.safetensors"
DRAIN_S = 5.0  # after the run's end: for the last rollouts of actors that stop
REJOIN_S = 8.0  # after a restart: until the actors of before have found the learner again, and can be told the end
IDLE_S = 0.005


class Learner:
    """One run's learner. Construct, `run`, `close`; a second one on the same folder continues the first."""

    def __init__(self, bus: Bus, run: Run, settings: LearnerSettings) -> None:
        self.run_info, self.settings = run, settings
        self.replay = Replay(
            run.folder / "replay", settings.replay_capacity, settings.n_step, settings.gamma,
            observation_size=run.observation.size, scan_size=run.observation.scan_size, action_size=len(run.space),
            priority_exponent=settings.priority_exponent, sync=run.sync,
        )  # fmt: skip
        self.td3 = TD3(settings.td3, run.observation.size, len(run.space), seeds.stream(run.seed, "learner", "td3"))
        self.rng = seeds.generator(run.seed, "learner", "replay")
        self._started = self._opened = time.monotonic()
        self._expected_back = self.replay.ring.actors
        self.checkpoints = Checkpoints(run.folder / "checkpoints")
        self.version = 0
        self.checkpoints.reserve(self.td3)
        self.epoch = self._resume()
        self.limiter = RateLimiter(settings.limits(), self.replay.ring.transitions_total, self._samples())
        self.statistics = EpisodeStatistics(run.failed_time_s)
        self._publishing = _Every(settings.publish_every_s)
        self._reporting = _Every(settings.report_every_s)
        self._saving = _Every(settings.checkpoint_every_s)
        self.ingest = Ingest(self.replay.ring, self.limiter, run.run_id)
        self.publisher = WeightsPublisher(bus, run.run_id)
        self._published_updates = -1
        self._publish()
        self.roster = Roster(bus, run.run_id)
        self.server = UploadServer(bus, run.run_id, _Sink(self.ingest, self), epoch=self.epoch)
        self.telemetry = Telemetry(
            run, self.td3, self.replay, self.statistics, self.roster, self.server, self._elapsed_s, self.limiter
        )
        self.telemetry.renew(self.version)
        self.control = ControlServer(
            bus, run.run_id, json.dumps(run.config), epoch=self.epoch, status=lambda: asdict(self.telemetry.status())
        )

    def run(self, stop: Callable[[], bool], leave: Callable[[], bool] = lambda: False) -> bool:
        """Train until the run's transitions or minutes are reached, or `stop()`; then stop all actors.

        After `leave()` only keep what a successor needs: the actors wait for it. Whether the run has ended.

        Raises UserError, naming the last good checkpoint, if training diverges.
        """
        while not stop() and not leave() and not self.finished:
            if not self.step():
                time.sleep(IDLE_S)
        if leave() and not stop() and not self.finished:
            self.save()
            self.checkpoints.wait()
            log.info("left at %d transitions, %d updates", self.replay.ring.transitions_total, self.td3.updates)
            return False
        self.end()
        return True

    def step(self) -> bool:
        """One update if the limiter allows it, and whatever else is due; whether there was an update."""
        may_learn = self.limiter.may_sample(self.settings.td3.batch_size)
        with self._told_of_divergence():
            if may_learn:
                self._update()
            self._publishing.run(self._publish)
            self._reporting.run(lambda: self.telemetry.write(self.version))
            self._saving.run(self.save)
        return may_learn

    def end(self) -> None:
        """Stop the actors, take what they still send, and keep the final policy."""
        self.control.set_state("stop")
        self.limiter.open()
        # An actor that is not told goes on for its whole patience, and a run may end right after a restart.
        rejoined = self._opened + REJOIN_S
        deadline = max(time.monotonic(), rejoined if self._expected_back else 0.0) + DRAIN_S
        while (now := time.monotonic()) < deadline:
            actors = {m.member_id: m.alive for m in self.roster.members() if m.role == "actor"}
            if not any(actors.values()) and (now >= rejoined or self._expected_back <= actors.keys()):
                break
            time.sleep(0.05)
        self.version += 1
        with self._told_of_divergence():
            self.save()
            self.checkpoints.wait()
        self.telemetry.write(self.version)
        if self._out_of_time() and self.replay.ring.transitions_total < self.run_info.transitions:
            log.warning(
                "run.minutes=%g ended training before run.transitions=%d; run.resume=%s run.minutes=0 continues",
                self.run_info.minutes, self.run_info.transitions, self.run_info.folder,
            )  # fmt: skip
        counts, refused = self.server.counts, self.server.refused()
        log.info(
            "ended at %d transitions, %d updates; this process stored %d rollouts, answered %d repeats, refused %d%s",
            self.replay.ring.transitions_total, self.td3.updates,
            counts["stored"], counts["duplicate"], counts["refused"],
            f" (most of {', '.join(refused)})" if refused else "",
        )  # fmt: skip

    def save(self) -> None:
        """Write a checkpoint in the background and the newest policy; training goes on meanwhile."""
        self.checkpoints.save(self.td3, self.rng, self._counts())
        self._policy().save(self.run_info.folder / POLICY_FILE)
        self.telemetry.write_worlds()

    @contextmanager
    def _told_of_divergence(self) -> Iterator[None]:
        try:
            yield
        except Diverged as error:
            raise UserError(
                f"training diverged: {error}; the last good checkpoint is {self.checkpoints.newest() or 'none'}, "
                "resume from it with other learner settings"
            ) from None

    def close(self) -> None:
        """Let go of the wire and the files."""
        for part in (
            self.control,
            self.server,
            self.publisher,
            self.roster,
            self.checkpoints,
            self.telemetry,
            self.replay,
        ):
            part.close()

    @property
    def finished(self) -> bool:
        """Whether the run has its transitions, or its minutes are over."""
        return self.replay.ring.transitions_total >= self.run_info.transitions or self._out_of_time()

    def _out_of_time(self) -> bool:
        return 0.0 < self.run_info.minutes <= self._elapsed_s() / 60.0

    def _resume(self) -> int:
        """Load the newest checkpoint, if any; this process's epoch, one more than the last one's."""
        file = self.run_info.folder / "epoch.json"
        epoch = 1 + int(_number(file, _read_json(file), "epoch")) if file.exists() else 1
        found = self.checkpoints.load(self.td3, self.rng)
        if found is not None:
            path = self.checkpoints.newest()
            self.version = int(_number(path, found, "version"))
            self._started -= _number(path, found, "elapsed_s")
            log.info("resumed at %d transitions, %d updates", self.replay.ring.transitions_total, self.td3.updates)
        elif self.settings.init:
            log.info("learning starts from %s", initialise(self.td3, self.settings.init, self.run_info.space))
        write_atomic(file, json.dumps({"epoch": epoch}), sync=True)
        return epoch

    def _counts(self) -> dict[str, Any]:
        return {
            "version": self.version,
            "epoch": self.epoch,
            "transitions": self.replay.ring.transitions_total,
            "elapsed_s": self._elapsed_s(),
        }

    def _elapsed_s(self) -> float:
        """How long this run has trained, earlier learner processes up to their last checkpoint included."""
        return time.monotonic() - self._started

    def _samples(self) -> int:
        return self.td3.updates * self.settings.td3.batch_size

    def _update(self) -> None:
        batch = self.replay.sample(self.settings.td3.batch_size, self.rng)
        detail = self.td3.updates % self.settings.detail_every == 0
        metrics = self.td3.update(batch, detail)
        if batch.rows is not None:
            self.replay.prioritise(batch.rows, self.td3.errors.cpu().numpy())
        if detail:
            self.telemetry.learned(read(metrics))

    def _policy(self) -> PolicyFile:
        weights, biases = self.td3.policy_arrays()
        if not all(np.isfinite(array).all() for array in (*weights, *biases)):
            raise Diverged("the policy holds a value that is not finite")
        return PolicyFile(
            weights, biases, space=self.run_info.space, epoch=self.epoch, version=self.version,
            transitions=self.replay.ring.transitions_total, training=self.run_info.training,
            observation=self.run_info.observation,
        )  # fmt: skip

    def _publish(self) -> None:
        """A new version, unless the last one has these weights."""
        if self.td3.updates == self._published_updates:
            return
        self._published_updates = self.td3.updates
        self.version += 1
        self.statistics.current = (self.epoch, self.version)
        try:
            blob = replace(self._policy(), training=None).to_bytes(half=True)
        except ValueError as error:  # a weight that is not finite, or beyond float16
            raise Diverged(str(error)) from None
        self.publisher.publish(self.epoch, self.version, blob)


def _read_json(file: Path) -> Any:
    """What the file holds; None if that is not JSON."""
    try:
        return json.loads(file.read_text("utf-8"))
    except ValueError:
        return None


def _number(file: Path | None, found: Any, name: str) -> float:
    """A number a restart needs from one of the run's files; UserError if it is not there."""
    value = found.get(name) if isinstance(found, dict) else None
    if not isinstance(value, int | float) or not 0 <= value < math.inf:
        raise UserError(f"{file}: {name}: got {value!r}; a number, 0 or more, is needed to continue this run")
    return value


class _Sink:
    """Ingest, followed by the episode's figures."""

    def __init__(self, ingest: Ingest, learner: Learner) -> None:
        self._ingest, self._learner = ingest, learner
        self._warned: set[str] = set()

    def store(self, header: UploadHeader, rollout: Rollout) -> Ack:
        run = self._learner.run_info
        got = (rollout.observations.shape[1], rollout.scan_size, rollout.actions.shape[1])
        wanted = (run.observation.size, run.observation.scan_size, len(run.space))
        if got != wanted:
            raise ValueError(f"sizes of observation, scan and action: got {got}; this run has {wanted}")
        ack = self._ingest.store(header, rollout)
        if ack.status == "stored":
            try:
                self._learner.statistics.add(rollout)
            except ValueError as error:  # its transitions are good: only the figures go without it
                if header.actor not in self._warned:
                    self._warned.add(header.actor)
                    log.warning("actor %s sends episodes without usable figures: %s", header.actor, error)
        return ack

    def expected_seq(self, actor_id: str) -> int:
        return self._ingest.expected_seq(actor_id)


class _Every:
    """Runs something once a period, first after one period."""

    def __init__(self, period_s: float) -> None:
        self._period_s = period_s
        self._due = time.monotonic() + period_s

    def run(self, action: Callable[[], None]) -> None:
        now = time.monotonic()
        if now >= self._due:
            self._due = now + self._period_s
            action()
