"""Does a run whose learner is killed again and again learn what an undisturbed one learns?

    python benchmarks/recovery.py --minutes 10 --period 60      # two runs of ten minutes, side by side
    python benchmarks/recovery.py --minutes 1 --period 10       # a quick look

Both runs share seed, worlds and settings and run at the same time. In one, the learner gets SIGKILL every `period`
seconds and is restarted by the launcher. The curves are the returns of the rollouts as replay holds them, in the order
they were stored; the ledger of each run says whether anything was lost or stored twice.
"""

from __future__ import annotations

import argparse
import itertools
import json
import signal
import socket
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
import psutil

from appl_dist.launch.ledger import run_ledger
from appl_dist.learner.replay import Replay


def endpoint() -> str:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return f"tcp/127.0.0.1:{probe.getsockname()[1]}"


def start(folder: Path, overrides: list[str]) -> subprocess.Popen[bytes]:
    command = [sys.executable, "-m", "appl_dist", "train", f"wire.endpoint={endpoint()}", f"run.folder={folder}"]
    with folder.with_suffix(".txt").open("wb") as out:
        return subprocess.Popen([*command, *overrides], stdout=out, stderr=subprocess.STDOUT)


def kill_learner(launcher: subprocess.Popen[bytes]) -> bool:
    for child in psutil.Process(launcher.pid).children(recursive=True):
        if "learner" in child.cmdline():
            child.kill()
            return True
    return False


def returns(folder: Path) -> tuple[np.ndarray, np.ndarray]:
    """(transitions stored up to and including, return) of every rollout, in the order stored."""
    with Replay.reopen(folder / "replay") as replay:
        rows = [(len(stored.rewards), float(stored.rewards.sum())) for stored in replay.ring.rollouts()]
    counts, values = np.array(rows).T
    return np.cumsum(counts), values


def recovery_times_s(folder: Path, killed_at: list[float]) -> list[float]:
    """From each kill to the first report of new transitions."""
    lines = [json.loads(line) for line in (folder / "metrics.jsonl").read_text().splitlines()]
    times = []
    for at in killed_at:
        before = max((line["step"] for line in lines if line["unix_s"] <= at), default=0)
        later = [line["unix_s"] for line in lines if line["unix_s"] > at and line["step"] > before]
        if later:
            times.append(later[0] - at)
    return times


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--minutes", type=float, default=10.0)
    parser.add_argument("--period", type=float, default=60.0, help="seconds between kills")
    parser.add_argument("--folder", type=Path, help="where the runs go (default: a temporary folder)")
    parser.add_argument("--blocks", type=int, default=4, help="parts of the curve to compare")
    parser.add_argument("overrides", nargs="*", help="settings of both runs, key=value")
    arguments = parser.parse_args()
    folder = arguments.folder or Path(tempfile.mkdtemp(prefix="recovery-"))
    folder.mkdir(parents=True, exist_ok=True)
    overrides = ["actors=1", "run.transitions=8000", "learner.min_transitions=500", *arguments.overrides]
    runs = {name: start(folder / name, overrides) for name in ("alone", "killed")}
    began, killed_at = time.monotonic(), []
    try:
        while (left_s := began + 60.0 * arguments.minutes - time.monotonic()) > 0.0:
            time.sleep(min(arguments.period, left_s))
            if left_s > arguments.period and kill_learner(runs["killed"]):
                killed_at.append(time.time())
    finally:
        for process in runs.values():
            process.send_signal(signal.SIGINT)
        for process in runs.values():
            process.wait(60)
    curves = {name: returns(folder / name) for name in runs}
    end = min(totals[-1] for totals, _ in curves.values())
    edges = np.linspace(0, end, arguments.blocks + 1)
    print(f"learner killed {len(killed_at)} times in {arguments.minutes:g} minutes; runs in {folder}")
    print(f"{'transitions':>14}  {'alone':>16}  {'killed':>16}  difference [95 %]")
    for low, high in itertools.pairwise(edges):
        means, variances, texts = [], [], []
        for totals, values in curves.values():
            block = values[(totals > low) & (totals <= high)]
            means.append(block.mean())
            variances.append(block.var(ddof=1) / len(block))
            texts.append(f"{block.mean():8.2f} (n {len(block)})")
        half = 1.96 * float(np.sqrt(sum(variances)))
        gap = means[1] - means[0]
        interval = f"{gap:+.2f} [{gap - half:+.2f}, {gap + half:+.2f}]"
        print(f"{low:6.0f}-{high:6.0f}   {texts[0]:>16}  {texts[1]:>16}  {interval}")
    for name in runs:
        print(f"{name:>7}: {run_ledger(folder / name).sentence()}")
    times_s = recovery_times_s(folder / "killed", killed_at)
    if times_s:
        print(
            f"from a kill to new transitions in replay: median {np.median(times_s):.1f} s, worst {max(times_s):.1f} s"
        )


if __name__ == "__main__":
    main()
