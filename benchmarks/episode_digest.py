"""Whether two checkouts drive the same episodes, bit for bit, with the random parameters of exploration.

    python benchmarks/episode_digest.py --worlds ../shared/barn --episodes 10 --other ../old_checkout

Prints one digest of every observation, reward and end of every episode; with `--other` (a built checkout) its digests
beside them, and exit status 1 where one differs.
"""

from __future__ import annotations

import argparse
import hashlib
import os
import subprocess
import sys
from pathlib import Path

import numpy as np


def digests(worlds: str, episodes: int, timing: str) -> list[str]:
    """One line an episode: world, simulated ms, digest."""
    from appl_dist.actor.env import NavigationEnv
    from appl_dist.actor.world_split import select_worlds
    from appl_dist.config import load

    settings = load([f"timing={timing}", f"world.path={worlds}"])
    env = NavigationEnv(
        select_worlds(worlds, 300, 0, "train"), timing=settings.timing, planner=settings.planner, robot=settings.robot
    )
    lines = []
    for episode in range(episodes):
        rng = np.random.default_rng(episode)
        observation, _ = env.reset(seed=1000 + episode)
        digest = hashlib.sha256(observation.tobytes())
        over = False
        while not over:
            observation, reward, terminated, truncated, info = env.step(rng.uniform(-1, 1, 8).astype(np.float32))
            over = terminated or truncated
            digest.update(observation.tobytes() + np.float64(reward).tobytes() + repr((terminated, truncated)).encode())
        lines.append(f"world {info['world']:3d}  {env.loop.now_ms:6d} ms  {digest.hexdigest()[:16]}")
    env.close()
    return lines


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--worlds", default="", help="folder of BARN worlds; generated ones without")
    parser.add_argument("--episodes", type=int, default=10)
    parser.add_argument("--timing", default="gazebo")
    parser.add_argument("--other", default="", help="another checkout, with its native module built")
    a = parser.parse_args()
    worlds = str(Path(a.worlds).resolve()) if a.worlds else ""
    here = digests(worlds, a.episodes, a.timing)
    there = here
    if a.other:
        command = [sys.executable, str(Path(__file__).resolve()), "--worlds", worlds, "--timing", a.timing]
        command += ["--episodes", str(a.episodes)]
        environment = os.environ | {"PYTHONPATH": str(Path(a.other).resolve())}
        run = subprocess.run(command, env=environment, capture_output=True, text=True, check=False)
        if run.returncode:
            sys.exit(f"--other: {a.other} cannot be run: {run.stderr.strip().splitlines()[-1]}")
        there = run.stdout.strip().splitlines()[: len(here)]
    for mine, theirs in zip(here, there, strict=True):
        print(mine if mine == theirs else f"{mine}   DIFFERS: {theirs}")
    sys.exit(0 if here == there else 1)


if __name__ == "__main__":
    main()
