"""Telemetry of a training run: the status that views ask for, metrics.jsonl and TensorBoard."""

from __future__ import annotations

import logging
import time
from collections.abc import Callable, Mapping
from dataclasses import replace

from appl_dist.learner.episodes import EpisodeStatistics
from appl_dist.learner.limiter import RateLimiter
from appl_dist.learner.metrics_writer import MetricsWriter
from appl_dist.learner.replay import Replay
from appl_dist.learner.run_info import Run
from appl_dist.learner.td3 import TD3
from appl_dist.wire.liveness import Member, Roster
from appl_dist.wire.run_status import ActorStatus, Progress, RunStatus
from appl_dist.wire.upload import UploadServer

log = logging.getLogger(__name__)

# What of the status goes to TensorBoard and metrics.jsonl, and its name there.
SCALARS = {
    "success": "episode/success",
    "time_s": "episode/time_s",
    "return_": "episode/return",
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


NEVER_S = 1e9  # silent since ever: an actor whose first report is still to come


class Telemetry:
    """The figures of one learner process. `elapsed_s`: how long the run has trained, earlier processes included."""

    def __init__(
        self,
        run: Run,
        td3: TD3,
        replay: Replay,
        statistics: EpisodeStatistics,
        roster: Roster,
        server: UploadServer,
        elapsed_s: Callable[[], float],
        limiter: RateLimiter,
    ) -> None:
        self._run, self._td3, self._replay = run, td3, replay
        self._statistics, self._roster, self._server, self._elapsed_s = statistics, roster, server, elapsed_s
        self._metrics = MetricsWriter(run.folder)
        self._rates = _Rates()
        self._limiter, self._warned = limiter, False
        self._learned: dict[str, float] = {}
        self._status: RunStatus | None = None

    def learned(self, numbers: Mapping[str, float]) -> None:
        """Take an update's figures: losses, norms, saturation."""
        self._learned.update(self._named(numbers))

    def write(self, version: int) -> None:
        """Renew the status and append it and the newest figures of learning to the metrics."""
        status = self.renew(version)
        values = {tag: getattr(status, name) for name, tag in SCALARS.items()}
        scalars = {tag: float(value) for tag, value in values.items() if value is not None}
        self._metrics.write(self._replay.ring.transitions_total, {**scalars, **self._learned})

    def write_worlds(self) -> None:
        """Success and time of every training world so far: seldom, being two numbers a world."""
        scalars: dict[str, float] = {}
        for world, (_, success, time_s) in sorted(self._statistics.worlds().items()):
            scalars |= {f"world_success/{world}": success, f"world_time_s/{world}": time_s}
        if scalars:
            self._metrics.write(self._replay.ring.transitions_total, scalars)

    def status(self) -> RunStatus:
        """The last status, with its age: a learner that hangs still answers, from the wire's thread."""
        status = self._status
        assert status is not None, "renew() comes first"
        return replace(status, age_s=max(self._elapsed_s() - status.elapsed_s, 0.0))

    def renew(self, version: int) -> RunStatus:
        """Bring the status up to date; `version`: of the newest policy."""
        transitions, updates = self._replay.ring.transitions_total, self._td3.updates
        self._rates.mark(transitions, updates)
        actors = tuple(_actor(m) for m in self._roster.members() if m.role == "actor" and m.alive)
        self._status = RunStatus(
            run_id=self._run.run_id,
            run_transitions=self._run.transitions,
            transitions=transitions,
            updates=updates,
            elapsed_s=self._elapsed_s(),
            age_s=0.0,
            transitions_per_s=self._rates.transitions_per_s,
            updates_per_s=self._rates.updates_per_s,
            samples_per_insert=updates * self._td3.settings.batch_size / max(transitions, 1),
            queue=sum(a.pending for a in actors),
            version=version,
            sigma=self._run.sigma(transitions),
            **self._statistics.figures(),
            refused=self._server.refused(),
            held_back=self._held_back(len(actors)),
            actors=actors,
        )
        return self._status

    def _held_back(self, actors: int) -> str:
        """A sentence while learning holds the actors back, "" otherwise; the log has it once."""
        if not self._limiter.actors_wait or self._rates.updates_per_s <= 0.0:
            return ""
        settings = self._limiter.settings
        takes = self._rates.updates_per_s * settings.batch_size / settings.samples_per_insert
        sentence = (
            f"learning holds {actors} actors back: {self._rates.updates_per_s:.1f} updates/s take {takes:.0f} "
            f"transitions/s at learner.samples_per_insert={settings.samples_per_insert:g}; lower that, or choose "
            "smaller networks or more learner.td3.threads"
        )
        if not self._warned:
            self._warned = True
            log.warning("%s", sentence)
        return sentence

    def close(self) -> None:
        """Flush the metrics."""
        self._metrics.close()

    def _named(self, numbers: Mapping[str, float]) -> dict[str, float]:
        """Saturation by the parameter's name instead of its number."""
        names = self._run.space.names
        return {
            f"saturation/{names[int(k.split('/')[1])]}" if k.startswith("saturation/") else k: v
            for k, v in numbers.items()
        }


def _actor(member: Member) -> ActorStatus:
    progress = member.progress or Progress()
    return ActorStatus(
        id=member.member_id,
        transitions_per_s=member.rate,
        world=progress.world,
        version=progress.policy_version,
        pending=progress.pending,
        silent_s=min(member.silent_s, NEVER_S),
        host=progress.host,
    )


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
