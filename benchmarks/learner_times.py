"""How long a learner takes to its first update, new and resumed, and how long a checkpoint holds training up.

Default networks; the resumed learner finds a checkpoint and a replay of --transitions. Each start is a fresh process,
timed from the outside.

    python benchmarks/learner_times.py [--transitions 100000] [--saves 10]
"""

from __future__ import annotations

import argparse
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path

START = """
import sys
from pathlib import Path
from appl_dist.learner.learner import Learner
from appl_dist.learner.run_info import Run
from appl_dist.learner.settings import LearnerSettings
from appl_dist.planner.dwa import DWA
from appl_dist.wire.memory import MemoryHub

run = Run("run", Path(sys.argv[1]), 0, 10**9, 0.0, {}, DWA, LAYOUT, 70.0, lambda _: 0.1)
learner = Learner(MemoryHub().connect(), run, LearnerSettings(min_transitions=1000))
assert learner.step()
print("updated", flush=True)
"""


def first_update_s(folder: Path) -> float:
    """Seconds from starting a process to its first update."""
    began = time.perf_counter()
    with subprocess.Popen([sys.executable, "-c", START, str(folder)], stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == "updated\n"
        took = time.perf_counter() - began
        process.kill()
    return took


def fill(folder: Path, transitions: int) -> None:
    """A replay of noise, as an earlier learner left it."""
    import numpy as np
    from paper_sizes import LAYOUT, OBSERVATION_SIZE, SIZES

    from appl_dist.learner.replay import Replay
    from appl_dist.learner.settings import LearnerSettings
    from appl_dist.spec import Rollout

    rng = np.random.default_rng(0)
    observations = rng.uniform(-1, 1, (41, OBSERVATION_SIZE)).astype(np.float32)
    actions = rng.uniform(-1, 1, (40, 8)).astype(np.float32)
    rollout = Rollout(observations, actions, np.zeros(40, np.float32), True, {}, LAYOUT.scan_size)
    settings = LearnerSettings()
    with Replay(folder / "replay", settings.replay_capacity, settings.n_step, settings.gamma, **SIZES) as replay:
        for seq in range(transitions // 40):
            replay.ring.insert(rollout, "bench", seq)


def checkpoints(folder: Path, saves: int) -> None:
    """Save while training, and report how long `save` and the updates during a write take."""
    import numpy as np
    from paper_sizes import OBSERVATION_SIZE, SIZES

    from appl_dist.learner.checkpoint import Checkpoints
    from appl_dist.learner.replay import Replay
    from appl_dist.learner.settings import LearnerSettings, TD3Settings
    from appl_dist.learner.td3 import TD3

    settings = LearnerSettings()
    learner, rng = TD3(TD3Settings(), OBSERVATION_SIZE, 8), np.random.default_rng(0)
    keeper = Checkpoints(folder / "checkpoints")
    with Replay(folder / "replay", settings.replay_capacity, settings.n_step, settings.gamma, **SIZES) as replay:

        def updates(count: int) -> list[float]:
            times = []
            for _ in range(count):
                began = time.perf_counter()
                learner.update(replay.sample(256, rng))
                times.append(1e3 * (time.perf_counter() - began))
            return times

        keeper.reserve(learner)
        alone = updates(30)[10:]
        held, busy, beside, written = [], [], [], []
        for _ in range(saves):
            began, used = time.perf_counter(), time.thread_time()
            keeper.save(learner, rng, {"version": 0, "elapsed_s": 0.0})
            held.append(1e3 * (time.perf_counter() - began))
            busy.append(1e3 * (time.thread_time() - used))
            beside += updates(8)
            keeper.wait()
            written.append(1e3 * (time.perf_counter() - began))
    path = keeper.newest()
    assert path is not None

    def figures(times: list[float]) -> str:
        return f"{statistics.median(times):.1f} ms, at most {max(times):.1f}"

    print(f"checkpoint of {path.stat().st_size / 1e6:.0f} MB: holds training up {figures(held)}")
    print(f"  processor time of that: {figures(busy)}; until written: {figures(written)}")
    print(f"update alone: {figures(alone)}; while a checkpoint is written: {figures(beside)}")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else "")
    parser.add_argument("--transitions", type=int, default=100_000)
    parser.add_argument("--saves", type=int, default=10)
    args = parser.parse_args()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        fill(folder, args.transitions)
        print(f"new learner: {first_update_s(folder):.2f} s to the first update")
        checkpoints(folder, args.saves)
        print(f"resumed learner: {first_update_s(folder):.2f} s to the first update")


if __name__ == "__main__":
    main()
