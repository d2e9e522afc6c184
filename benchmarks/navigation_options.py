"""Which additions to plain TD3 help on navigation? Equal transitions and equal processor time on a few BARN worlds.

One process acts and learns in turns. Each run is scored without exploration on its own worlds, several times on the
way; a trial that fails counts 70 s. Every finished run is a line in OUT/runs.jsonl and is not run again; `--report`
only prints the table.

    python benchmarks/navigation_options.py --worlds BARN [--variants NAME ...] [--seeds 3] [--transitions 2000]
"""

from __future__ import annotations

import argparse
import itertools
import json
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from paper_sizes import OBSERVATION_SIZE, SIZES

from appl_dist.actor.env import NavigationEnv
from appl_dist.actor.exploration import ExplorationSettings, explore
from appl_dist.actor.rollout import collect
from appl_dist.actor.world_split import select_worlds
from appl_dist.learner.replay import Replay
from appl_dist.learner.settings import TD3Settings
from appl_dist.learner.td3 import TD3
from appl_dist.planner.planner_settings import PlannerSettings
from appl_dist.spec import FloatArray

GAMMA, WARM_UP, SCORES, TRIALS, FAILED_S = 0.99, 300, 4, 3, 70.0
HIDDEN = (256, 256)
EXPLORATION = ExplorationSettings(sigma_start=0.4, sigma_floor=0.1, uniform_fraction=0.1)
WORLDS = "1,61,122,183,239,290"


@dataclass(frozen=True)
class Variant:
    """What is added to TD3. updates: per transition."""

    n_step: int = 1
    layer_norm: bool = False
    updates: int = 1
    priority_exponent: float = 0.0
    precision: str = "auto"


VARIANTS = {
    "plain": Variant(),
    "plain, fp32": Variant(precision="fp32"),
    "n-step 4": Variant(n_step=4),
    "layer norm": Variant(layer_norm=True),
    "4 updates": Variant(updates=4),
    "prioritised": Variant(priority_exponent=0.6),
}


class Trial:
    """One run of one variant."""

    def __init__(self, env: NavigationEnv, variant: Variant, seed: int, transitions: int) -> None:
        self.env, self.variant, self.seed, self.transitions = env, variant, seed, transitions
        self.settings = TD3Settings(hidden=HIDDEN, layer_norm=variant.layer_norm, precision=variant.precision)
        self.learner = TD3(self.settings, OBSERVATION_SIZE, len(env.space), seed)
        self.replay = Replay(None, 20_000, variant.n_step, GAMMA, priority_exponent=variant.priority_exponent, **SIZES)
        self.rng = np.random.default_rng(seed)

    def run(self) -> dict[str, Any]:
        began = time.process_time()
        scoring = 0.0
        scores: list[dict[str, float]] = []
        returns: list[float] = []
        for episode in itertools.count():
            rollout = collect(self.env, self._explore, seed=1000 * self.seed + episode)
            assert rollout is not None
            returns.append(rollout.info["return_"])
            self.replay.ring.insert(rollout, "trial", episode)
            self._learn(len(rollout))
            done = self.replay.ring.transitions_total / self.transitions
            if done >= (len(scores) + 1) / SCORES:
                paused = time.process_time()
                score = self._score()
                scoring += time.process_time() - paused
                processor_s = time.process_time() - began - scoring
                scores.append({"transitions": self.replay.ring.transitions_total, "processor_s": processor_s, **score})
            if done >= 1.0:
                third = returns[-len(returns) // 3 :]
                return {"scores": scores, "training_return": float(np.mean(third)), "episodes": len(returns)}
        raise AssertionError

    def _act(self, observation: FloatArray) -> FloatArray:
        x = torch.from_numpy(observation[None])
        action: FloatArray = self.learner.actor.forward(x).output[0, 0].tanh().numpy()
        return action

    def _explore(self, observation: FloatArray) -> FloatArray:
        done = self.replay.ring.transitions_total
        return explore(self._act(observation), EXPLORATION, done, self.transitions, self.rng)

    def _learn(self, new: int) -> None:
        total = self.replay.ring.transitions_total
        if total < WARM_UP:
            return
        if total - new < WARM_UP:
            new = total
        for _ in range(new * self.variant.updates):
            batch = self.replay.sample(self.settings.batch_size, self.rng)
            self.learner.update(batch)
            if batch.rows is not None:
                self.replay.prioritise(batch.rows, self.learner.errors.numpy())

    def _score(self) -> dict[str, float]:
        """Mean time, success and return of the policy on its worlds, the same trials for every run."""
        infos = []
        for world, trial in itertools.product(self.env.worlds, range(TRIALS)):
            rollout = collect(self.env, self._act, seed=10_000_000 + trial, world=world)
            assert rollout is not None
            infos.append(rollout.info)
        times = [i["time_s"] if i["success"] else FAILED_S for i in infos]
        return {
            "time_s": float(np.mean(times)),
            "success": float(np.mean([i["success"] for i in infos])),
            "return": float(np.mean([i["return_"] for i in infos])),
        }


def at_equal_time(run: dict[str, Any], processor_s: float) -> float:
    """The time_s this run had reached after so many seconds of processor time, between its scores linearly."""
    at = [s["processor_s"] for s in run["scores"]]
    return float(np.interp(processor_s, at, [s["time_s"] for s in run["scores"]]))


def table(runs: list[dict[str, Any]]) -> str:
    by = {name: [r for r in runs if r["variant"] == name] for name in VARIANTS}
    budget = float(np.mean([r["scores"][-1]["processor_s"] for r in by["plain"]])) if by["plain"] else 0.0
    lines = [
        "| variant | time at the end, s (seeds) | last two scores, ± standard error "
        f"| after {budget:.0f} s of processor | success, % | return while training | processor s |",
        "|---|---|---|---|---|---|---|",
    ]
    for name, found in by.items():
        if not found:
            continue
        last = [r["scores"][-1] for r in found]
        times = [s["time_s"] for s in last]
        late = [np.mean([s["time_s"] for s in r["scores"][-2:]]) for r in found]
        cells = (
            name,
            f"{np.mean(times):.1f} ({', '.join(f'{t:.1f}' for t in times)})",
            f"{np.mean(late):.1f} ± {np.std(late) / max(len(late) - 1, 1) ** 0.5:.1f}",
            f"{np.mean([at_equal_time(r, budget) for r in found]):.1f}",
            f"{100 * np.mean([s['success'] for s in last]):.0f}",
            f"{np.mean([r['training_return'] for r in found]):.1f}",
            f"{np.mean([s['processor_s'] for s in last]):.0f}",
        )
        lines.append(f"| {' | '.join(cells)} |")
    return "\n".join(lines)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else "")
    parser.add_argument("--worlds", required=True, help="the BARN worlds")
    parser.add_argument("--split", default=WORLDS)
    parser.add_argument("--variants", nargs="+", choices=list(VARIANTS), default=list(VARIANTS))
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--transitions", type=int, default=2000)
    parser.add_argument("--out", type=Path, default=Path("outputs/navigation_options"))
    parser.add_argument("--report", action="store_true")
    args = parser.parse_args()
    args.out.mkdir(parents=True, exist_ok=True)
    results = args.out / "runs.jsonl"
    runs = [json.loads(line) for line in results.read_text().splitlines()] if results.exists() else []
    if not args.report:
        worlds = select_worlds(args.worlds, 300, 0, args.split)
        env = NavigationEnv(worlds, planner=PlannerSettings(arithmetic="fast"))  # as actors train
        for seed, name in itertools.product(range(args.seeds), args.variants):  # seeds outside: an early end is fair
            if any(r["variant"] == name and r["seed"] == seed for r in runs):
                continue
            outcome = Trial(env, VARIANTS[name], seed, args.transitions).run()
            runs.append({"variant": name, "seed": seed, **outcome})
            with open(results, "a", encoding="utf-8") as file:
                file.write(json.dumps(runs[-1]) + "\n")
            print(f"seed {seed}  {name:30s} {outcome['scores'][-1]['time_s']:6.1f} s", flush=True)
    print(table(runs))


if __name__ == "__main__":
    main()
