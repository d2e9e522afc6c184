"""Does a learner that is killed every minute end with the curve of one left alone? With enough data to tell.

    python -m benchmarks.recovery_curve                                  # ten minutes, three runs of each kind
    python -m benchmarks.recovery_curve --minutes 1 --period 10          # a quick look

Learner, wire, replay, checkpoints, spool, uploads, weights and exploration are the real ones, each learner and actor a
process; only driving is replaced, so that the curve has tens of thousands of transitions instead of the few thousand
that a simulator makes on these cores (that one is benchmarks/recovery.py): in ten steps, hit the eight numbers of the
observation, scaled by 0.8; reward is 1 minus the mean square of the misses. Every actor makes `--rate` transitions a
second, also while its learner is away. Runs of a pair share their seed; all runs go at the same time.
"""

from __future__ import annotations

import argparse
import itertools
import multiprocessing
import os
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from types import SimpleNamespace
from typing import cast

import numpy as np
from paper_sizes import LIDAR_BEAMS, OBSERVATION_SIZE

from appl_dist.actor.collect import Explorer
from appl_dist.actor.env import NavigationEnv
from appl_dist.actor.spool import Spool
from appl_dist.config import from_dict
from appl_dist.launch.ledger import run_ledger
from appl_dist.launch.processes import die_with_parent
from appl_dist.planner.dwa import DWA
from appl_dist.spec import Rollout
from appl_dist.wire.codec import encode_rollout
from appl_dist.wire.control import ControlClient, fetch_run
from appl_dist.wire.liveness import Presence
from appl_dist.wire.run_status import Progress
from appl_dist.wire.session import open_session
from appl_dist.wire.uploader import Uploader
from appl_dist.wire.weights import WeightsSubscriber
from appl_dist.wire.wire_settings import WireSettings
from benchmarks.recovery import endpoint, returns

STEPS = 10
START_S = 300.0
OVERRIDES = (
    "world.count=6", "learner.td3.hidden=[64,64]", "learner.samples_per_insert=32", "learner.min_transitions=1000",
    "learner.replay_capacity=100000", "learner.td3.actor_lr=1e-4", "learner.td3.critic_lr=1e-4",
)  # fmt: skip


def actor(address: str, folder: Path, seed: int, rate_hz: float) -> None:
    die_with_parent()
    rng = np.random.default_rng([seed, 1])
    with (
        open_session(WireSettings(address, timeout_s=START_S), listen=False) as session,
        Spool(folder / "spool" / "actor-0", f"{folder.name}/actor-0", 100_000) as spool,
    ):
        run_id, served = fetch_run(session, START_S)
        settings = from_dict(served)
        uploader, control = Uploader(session, run_id, "actor-0", spool), ControlClient(session, run_id)
        weights, presence = WeightsSubscriber(session, run_id), Presence(session, run_id, "actor", "actor-0")
        space = cast(NavigationEnv, SimpleNamespace(space=DWA))
        explorer = Explorer(weights, space, settings.explore, rng)
        uploader.start(START_S)
        due = time.monotonic()
        while control.state() == "run":
            spool.put(encode_rollout(episode(explorer, rng)))
            presence.beat(Progress(transitions=spool.produced, pending=len(spool)))
            due += STEPS / rate_hz
            time.sleep(max(0.0, due - time.monotonic()))
        uploader.close(5.0)
        for part in (control, weights, presence):
            part.close()


def episode(explorer: Explorer, rng: np.random.Generator) -> Rollout:
    observations = np.zeros((STEPS + 1, OBSERVATION_SIZE), np.float32)
    observations[:, LIDAR_BEAMS + 1 :] = rng.uniform(-1.0, 1.0, (STEPS + 1, len(DWA)))
    epoch, version = explorer.held
    actions = np.stack([explorer.choose(observation) for observation in observations[:-1]])
    misses = actions - 0.8 * observations[:-1, LIDAR_BEAMS + 1 :]
    rewards = (1.0 - (misses**2).mean(1)).astype(np.float32)
    info = {
        "world": 0, "ended": True, "success": True, "time_s": 0.0, "return_": float(rewards.sum()),
        "policy_epoch": max(epoch, 0), "policy_version": max(version, 0),
    }  # fmt: skip
    return Rollout(observations, actions, rewards, True, info, LIDAR_BEAMS)


class Run:
    """A learner, started again whenever it dies, and its actor."""

    def __init__(self, folder: Path, seed: int, transitions: int, rate_hz: float) -> None:
        self.folder, self.address, self.kills = folder, endpoint(), 0
        self._command = [
            sys.executable, "-m", "appl_dist", "learner", f"run.folder={folder}", f"run.seed={seed}",
            f"run.transitions={transitions}", f"wire.endpoint={self.address}", *OVERRIDES,
        ]  # fmt: skip
        self._start()
        context = multiprocessing.get_context("spawn")
        self._actor = context.Process(target=actor, args=(self.address, folder, seed, rate_hz))
        self._actor.start()

    def watch(self) -> bool:
        """Whether it still goes on."""
        if self._learner.poll() not in (None, 0):
            self._start()
        return self._learner.poll() is None

    def kill(self) -> None:
        if self._learner.poll() is None:
            self._learner.kill()
            self._learner.wait()
            self.kills += 1

    def end(self) -> None:
        self._learner.send_signal(signal.SIGTERM)
        self._learner.wait(120)
        self._actor.join(60)

    def _start(self) -> None:
        with self.folder.with_suffix(".txt").open("ab") as out:
            self._learner = subprocess.Popen(self._command, stdout=out, stderr=out)


def table(curves: dict[str, list[tuple[np.ndarray, np.ndarray]]], blocks: int) -> None:
    """Mean return by block of the curve; the difference of pairs with its 95 % interval over them (Student's t)."""
    from scipy import stats

    end = min(totals[-1] for runs in curves.values() for totals, _ in runs)
    print(f"{'transitions':>15}  {'alone':>7}  {'killed':>7}  difference [95 % over pairs]")
    for low, high in itertools.pairwise(np.linspace(0, end, blocks + 1)):
        alone, killed = (
            np.array([values[(totals > low) & (totals <= high)].mean() for totals, values in runs])
            for runs in (curves["alone"], curves["killed"])
        )
        gaps = killed - alone
        half = stats.t.ppf(0.975, len(gaps) - 1) * gaps.std(ddof=1) / np.sqrt(len(gaps)) if len(gaps) > 1 else np.nan
        print(
            f"{low:7.0f}-{high:7.0f}  {alone.mean():7.3f}  {killed.mean():7.3f}  {gaps.mean():+.3f} "
            f"[{gaps.mean() - half:+.3f}, {gaps.mean() + half:+.3f}]"
        )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--minutes", type=float, default=10.0)
    parser.add_argument("--period", type=float, default=60.0, help="s between kills, above checkpoint_every_s")
    parser.add_argument("--rate", type=float, default=50.0, help="transitions a second of every run")
    parser.add_argument("--pairs", type=int, default=3)
    parser.add_argument("--blocks", type=int, default=8)
    parser.add_argument("--folder", type=Path, help="where the runs go (default: a temporary folder)")
    arguments = parser.parse_args()
    folder = arguments.folder or Path(tempfile.mkdtemp(prefix="recovery-"))
    folder.mkdir(parents=True, exist_ok=True)
    transitions = round(60.0 * arguments.minutes * arguments.rate)
    runs: dict[str, list[Run]] = {"alone": [], "killed": []}
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    try:
        for seed, kind in itertools.product(range(arguments.pairs), runs):
            runs[kind].append(Run(folder / f"{kind}-{seed}", seed, transitions, arguments.rate))
        kill_at = time.monotonic() + arguments.period
        last_kill = kill_at + 60.0 * arguments.minutes - arguments.period
        while sum(run.watch() for run in itertools.chain(*runs.values())):
            time.sleep(0.5)
            if time.monotonic() >= kill_at and kill_at <= last_kill:
                kill_at += arguments.period
                for run in runs["killed"]:
                    run.kill()
    finally:
        for run in itertools.chain(*runs.values()):
            run.end()
    kills = [run.kills for run in runs["killed"]]
    print(f"learners killed {kills} times in {transitions} transitions; runs in {folder}")
    table({kind: [returns(run.folder) for run in of_kind] for kind, of_kind in runs.items()}, arguments.blocks)
    for run in itertools.chain(*runs.values()):
        print(f"{run.folder.name:>9}: {run_ledger(run.folder).sentence()}")


if __name__ == "__main__":
    main()
