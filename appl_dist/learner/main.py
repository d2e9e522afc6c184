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
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from appl_dist.errors import UserError
from appl_dist.files import write_atomic
from appl_dist.learner.augment import mirrored
from appl_dist.learner.checkpoint import Checkpoints
from appl_dist.learner.episodes import EpisodeStatistics
from appl_dist.learner.ingest import Ingest
from appl_dist.learner.limiter import RateLimiter
from appl_dist.learner.metrics import MetricsWriter
from appl_dist.learner.replay import Replay
from appl_dist.learner.settings import LearnerSettings
from appl_dist.learner.td3 import TD3, Diverged, read
from appl_dist.policy_file import PolicyFile
from appl_dist.spec import OBSERVATION_SIZE, ParameterSpace, Rollout
from appl_dist.wire.bus import Bus
from appl_dist.wire.codec import Ack, UploadHeader
from appl_dist.wire.control import ControlServer
from appl_dist.wire.liveness import Roster
from appl_dist.wire.upload import UploadServer
from appl_dist.wire.weights import WeightsPublisher

log = logging.getLogger(__name__)

POLICY_FILE = "policy.safetensors"
# What of the status goes to TensorBoard and metrics.jsonl, and its name there.
SCALARS = {
    "success": "episode/success",
    "time_s": "episode/time_s",
    "return": "episode/return",
    "episodes": "episode/count",
    "staleness": "policy/staleness",
    "stale_share": "policy/stale_share",
    "version": "policy/version",
    "sigma": "policy/noise_sigma",
    "transitions_per_s": "rate/transitions_per_s",
    "updates_per_s": "rate/updates_per_s",
    "samples_per_insert": "rate/samples_per_insert",
    "updates": "rate/updates",
}
DRAIN_S = 5.0  # after the run's end: for the last rollouts of actors that stop
REJOIN_S = 8.0  # after a restart: until the actors of before have found the learner again, and can be told the end
IDLE_S = 0.005


@dataclass(frozen=True)
class Run:
    """What this run is: its id, folder, seed, length, and the frozen configuration served to actors."""

    run_id: str
    folder: Path
    seed: int
    transitions: int
    minutes: float
    config: dict[str, Any]
    space: ParameterSpace
    failed_time_s: float
    sigma: Callable[[int], float]  # exploration noise after so many transitions, for the status
    sync: bool = False  # what is acknowledged is on the disk


class Learner:
    """One run's learner. Construct, `run`, `close`; a second one on the same folder continues the first."""

    def __init__(self, bus: Bus, run: Run, settings: LearnerSettings) -> None:
        self.run_info, self.settings = run, settings
        self.replay = Replay(
            run.folder / "replay", settings.replay_capacity, settings.n_step, settings.gamma,
            priority_exponent=settings.priority_exponent, sync=run.sync,
        )  # fmt: skip
        self.td3 = TD3(settings.td3, OBSERVATION_SIZE, len(run.space), run.seed)
        self.rng = np.random.default_rng([run.seed, 0x7D3])
        self._started = self._opened = time.monotonic()
        self._expected_back = self.replay.actors
        self.checkpoints = Checkpoints(run.folder / "checkpoints")
        self.version = 0
        self.checkpoints.reserve(self.td3)
        self.epoch = self._resume()
        self.limiter = RateLimiter(settings.limits(), self.replay.transitions_total, self._samples())
        self.statistics = EpisodeStatistics(run.failed_time_s)
        self.metrics = MetricsWriter(run.folder)
        self._rates = _Rates()
        self._publishing = _Every(settings.publish_every_s)
        self._reporting = _Every(settings.report_every_s)
        self._saving = _Every(settings.checkpoint_every_s)
        self._last: dict[str, float] = {}
        self._status = self._status_now()
        self.ingest = Ingest(self.replay, self.limiter, run.run_id)
        self.publisher = WeightsPublisher(bus, run.run_id)
        self._published_updates = -1
        self._publish()
        self.roster = Roster(bus, run.run_id)
        self.server = UploadServer(bus, run.run_id, _Sink(self.ingest, self), epoch=self.epoch)
        self.control = ControlServer(
            bus, run.run_id, json.dumps(run.config), epoch=self.epoch, status=self._status_told
        )

    def run(self, stop: Callable[[], bool], leave: Callable[[], bool] = lambda: False) -> None:
        """Train until the run's transitions or minutes are reached, or `stop()`; then stop all actors.

        After `leave()` only keep what a successor needs: the actors go on and wait for it.

        Raises UserError, naming the last good checkpoint, if training diverges.
        """
        while not stop() and not leave() and not self.finished:
            if not self.step():
                time.sleep(IDLE_S)
        if leave():
            self.save()
            self.checkpoints.wait()
            log.info("left at %d transitions, %d updates", self.replay.transitions_total, self.td3.updates)
        else:
            self.end()

    def step(self) -> bool:
        """One update if the limiter allows it, and whatever else is due; whether there was an update."""
        may_learn = self.limiter.may_sample(self.settings.td3.batch_size)
        with self._told_of_divergence():
            if may_learn:
                self._update()
            self._publishing.run(self._publish)
            self._reporting.run(self._report)
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
        self._report()
        counts, refused = self.server.counts, self.server.refused()
        log.info(
            "ended at %d transitions, %d updates; this process stored %d rollouts, answered %d repeats, refused %d%s",
            self.replay.transitions_total, self.td3.updates, counts["stored"], counts["duplicate"], counts["refused"],
            f" (most of {', '.join(refused)})" if refused else "",
        )  # fmt: skip

    def save(self) -> None:
        """Write a checkpoint in the background and the newest policy; training goes on meanwhile."""
        self.checkpoints.save(self.td3, self.rng, self._counts())
        self._policy().save(self.run_info.folder / POLICY_FILE)
        self._report_worlds()

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
            self.metrics,
            self.replay,
        ):
            part.close()

    @property
    def finished(self) -> bool:
        """Whether the run has its transitions, or its minutes are over."""
        minutes = self._elapsed_s() / 60.0
        return self.replay.transitions_total >= self.run_info.transitions or 0.0 < self.run_info.minutes <= minutes

    def _resume(self) -> int:
        """Load the newest checkpoint, if any; this process's epoch, one more than the last one's."""
        file = self.run_info.folder / "epoch.json"
        epoch = 1 + int(_number(file, _read_json(file), "epoch")) if file.exists() else 1
        found = self.checkpoints.load(self.td3, self.rng)
        if found is not None:
            path = self.checkpoints.newest()
            self.version = int(_number(path, found, "version"))
            self._started -= _number(path, found, "elapsed_s")
            log.info("resumed at %d transitions, %d updates", self.replay.transitions_total, self.td3.updates)
        write_atomic(file, json.dumps({"epoch": epoch}), sync=True)
        return epoch

    def _counts(self) -> dict[str, Any]:
        return {
            "version": self.version,
            "epoch": self.epoch,
            "transitions": self.replay.transitions_total,
            "elapsed_s": self._elapsed_s(),
        }

    def _elapsed_s(self) -> float:
        """How long this run has trained, earlier learner processes up to their last checkpoint included."""
        return time.monotonic() - self._started

    def _samples(self) -> int:
        return self.td3.updates * self.settings.td3.batch_size

    def _update(self) -> None:
        batch = self.replay.sample(self.settings.td3.batch_size, self.rng)
        if self.settings.mirror:
            batch = mirrored(batch, self.rng)
        detail = self.td3.updates % self.settings.detail_every == 0
        metrics = self.td3.update(batch, detail)
        if batch.rows is not None:
            self.replay.prioritise(batch.rows, self.td3.errors.cpu().numpy())
        if detail:
            self._last.update(read(metrics))

    def _policy(self) -> PolicyFile:
        weights, biases = self.td3.policy_arrays()
        if not all(np.isfinite(array).all() for array in (*weights, *biases)):
            raise Diverged("the policy holds a value that is not finite")
        return PolicyFile(
            weights, biases, space=self.run_info.space, epoch=self.epoch, version=self.version,
            transitions=self.replay.transitions_total,
        )  # fmt: skip

    def _publish(self) -> None:
        """A new version, unless the last one has these weights."""
        if self.td3.updates == self._published_updates:
            return
        self._published_updates = self.td3.updates
        self.version += 1
        self.statistics.current = (self.epoch, self.version)
        try:
            blob = self._policy().to_bytes(half=True)
        except ValueError as error:  # a weight that is not finite, or beyond float16
            raise Diverged(str(error)) from None
        self.publisher.publish(self.epoch, self.version, blob)

    def _report(self) -> None:
        self._rates.mark(self.replay.transitions_total, self.td3.updates)
        self._status = status = self._status_now()
        scalars = {SCALARS[k]: float(status[k]) for k in SCALARS if status[k] is not None}
        self.metrics.write(self.replay.transitions_total, {**scalars, **self._named(self._last)})

    def _report_worlds(self) -> None:
        """Success and time of every training world so far: with the checkpoints, being two numbers a world."""
        scalars: dict[str, float] = {}
        for world, (_, success, time_s) in sorted(self.statistics.worlds().items()):
            scalars |= {f"world_success/{world}": success, f"world_time_s/{world}": time_s}
        if scalars:
            self.metrics.write(self.replay.transitions_total, scalars)

    def _named(self, numbers: dict[str, float]) -> dict[str, float]:
        """Saturation by the parameter's name instead of its number."""
        names = self.run_info.space.names
        return {
            f"saturation/{names[int(k.split('/')[1])]}" if k.startswith("saturation/") else k: v
            for k, v in numbers.items()
        }

    def _status_told(self) -> dict[str, Any]:
        """The last status, with its age: a learner that hangs still answers, from the wire's thread."""
        return {**self._status, "age_s": self._elapsed_s() - self._status["elapsed_s"]}

    def _status_now(self) -> dict[str, Any]:
        """What the terminal view, the metrics file and TensorBoard show."""
        transitions = self.replay.transitions_total
        actors = []
        if hasattr(self, "roster"):
            for m in self.roster.members():
                if m.role == "actor" and m.alive:
                    actors.append(
                        {
                            "id": m.member_id,
                            "transitions_per_s": m.rate,
                            "world": m.progress.get("world", -1),
                            "version": m.progress.get("policy_version", -1),
                            "pending": m.progress.get("pending", 0),
                            "silent_s": m.silent_s,
                            "host": str(m.progress.get("host", "")),
                        }
                    )
        return {
            "run_id": self.run_info.run_id,
            "run_transitions": self.run_info.transitions,
            "transitions": transitions,
            "updates": self.td3.updates,
            "elapsed_s": self._elapsed_s(),
            "transitions_per_s": self._rates.transitions_per_s,
            "updates_per_s": self._rates.updates_per_s,
            "samples_per_insert": self._samples() / max(transitions, 1),
            "refused": self.server.refused() if hasattr(self, "server") else {},
            "queue": sum(a["pending"] for a in actors),
            "version": self.version,
            "sigma": self.run_info.sigma(transitions),
            **self.statistics.figures(),
            "actors": actors,
        }


def _read_json(file: Path) -> Any:
    """What the file holds; None if that is not JSON."""
    try:
        return json.loads(file.read_text())
    except ValueError:
        return None


def _number(file: Path | None, found: Any, name: str) -> float:
    """A number a restart needs from one of the run's files; UserError if it is not there."""
    value = found.get(name) if isinstance(found, dict) else None
    if not isinstance(value, int | float) or not 0 <= value < math.inf:
        raise UserError(f"{file}: {name}: got {value!r}; a number, 0 or more, is needed to continue this run")
    return value


class _Sink:
    """Ingest, with the episode figures told of every rollout that was stored."""

    def __init__(self, ingest: Ingest, learner: Learner) -> None:
        self._ingest, self._learner = ingest, learner

    def store(self, header: UploadHeader, rollout: Rollout) -> Ack:
        ack = self._ingest.store(header, rollout)
        if ack.status == "stored":
            try:
                self._learner.statistics.add(rollout)
            except ValueError as error:  # its transitions are good: only the figures go without it
                log.warning("actor %s: an episode without usable figures: %s", header.actor, error)
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


class _Rates:
    """Transitions and updates per second between the last two reports."""

    def __init__(self) -> None:
        self._at = time.monotonic()
        self._before: tuple[int, int] | None = None
        self.transitions_per_s = self.updates_per_s = 0.0

    def mark(self, transitions: int, updates: int) -> None:
        now = time.monotonic()
        if self._before is not None and now > self._at:
            self.transitions_per_s = (transitions - self._before[0]) / (now - self._at)
            self.updates_per_s = (updates - self._before[1]) / (now - self._at)
        self._at, self._before = now, (transitions, updates)
