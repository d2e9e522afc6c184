"""Does the learner core learn what stable-baselines3's TD3 learns? Pendulum, Hopper and HalfCheetah, equal settings.

Networks, rates, batch, noise, warm-up and one update per step are the same for all; evaluation is without noise, on
the same starts each time. Curves are interquartile means over seeds with 95 % bootstrap bands, as rliable draws them
(Agarwal et al., NeurIPS 2021). Every finished run is a line in OUT/runs.jsonl and is not run again; OUT gets curves.png
and table.md.

    python benchmarks/td3_tasks.py [--tasks Pendulum-v1 ...] [--seeds N] [--steps N] [--out outputs/td3_tasks]
"""

from __future__ import annotations

import argparse
import itertools
import json
import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import torch
from scipy.stats import trim_mean
from stable_baselines3 import TD3 as BaselineTD3
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.noise import NormalActionNoise

from appl_dist.learner.replay import Replay
from appl_dist.learner.settings import TD3Settings
from appl_dist.learner.td3 import TD3
from appl_dist.spec import Rollout

HIDDEN, RATE, BATCH, SIGMA = (256, 256), 1e-3, 256, 0.1
RESAMPLES = 2000

Curve = list[float]  # return of each evaluation, every task.every steps
Act = Callable[[Any], Any]  # observation -> action in [-1, 1]


@dataclass(frozen=True)
class Task:
    """How long one run is, and how it is evaluated: every `every` steps on `episodes` starts."""

    name: str
    steps: int
    seeds: int
    every: int
    episodes: int
    warm_up: int
    gamma: float

    def make(self) -> gymnasium.Env[Any, Any]:
        """The environment with actions in [-1, 1], as float32."""
        env = gymnasium.wrappers.RescaleAction(gymnasium.make(self.name), -1.0, 1.0)
        box = env.observation_space
        assert box.shape is not None
        wanted = gymnasium.spaces.Box(-np.inf, np.inf, box.shape, np.float32)
        return gymnasium.wrappers.TransformObservation(env, np.float32, wanted)


TASKS = (
    Task("Pendulum-v1", 8_000, 5, 500, 10, 500, 0.98),
    Task("Hopper-v5", 30_000, 3, 2_000, 5, 1_000, 0.99),
    Task("HalfCheetah-v5", 30_000, 3, 2_000, 3, 1_000, 0.99),
)


def evaluate(task: Task, act: Act) -> float:
    """Mean return over the same starts each time."""
    env = task.make()
    total = 0.0
    for seed in range(task.episodes):
        obs, _ = env.reset(seed=10_000 + seed)
        over = False
        while not over:
            obs, reward, terminal, truncated, _ = env.step(act(obs))
            total += float(reward)
            over = terminal or truncated
    return total / task.episodes


def ours(task: Task, seed: int, precision: str) -> Curve:
    env = task.make()
    assert env.observation_space.shape is not None and env.action_space.shape is not None
    (obs_size,), (action_size,) = env.observation_space.shape, env.action_space.shape
    settings = TD3Settings(hidden=HIDDEN, batch_size=BATCH, actor_lr=RATE, critic_lr=RATE, precision=precision)
    learner = TD3(settings, obs_size, action_size, seed=seed)
    # Rollouts of one step, as the peer stores them: as many last observations as transitions.
    replay = Replay(
        None, 2 * task.steps, 1, task.gamma, observation_size=obs_size, scan_size=0, action_size=action_size
    )
    rng = np.random.default_rng(seed)

    def act(obs: Any) -> Any:
        with torch.no_grad():
            return learner.actor(torch.from_numpy(obs[None]))[0].numpy()

    curve: Curve = []
    obs, _ = env.reset(seed=seed)
    for step in range(1, task.steps + 1):
        if step <= task.warm_up:
            action = rng.uniform(-1, 1, action_size).astype(np.float32)
        else:
            action = np.clip(act(obs) + SIGMA * rng.standard_normal(action_size, np.float32), -1, 1)
        then, reward, terminal, truncated, _ = env.step(action)
        rollout = Rollout(np.stack([obs, then]), action[None], np.array([reward], np.float32), terminal, {}, 0)
        replay.ring.insert(rollout, "task", step - 1)
        obs = env.reset()[0] if terminal or truncated else then
        if step > task.warm_up:
            learner.update(replay.sample(BATCH, rng))
        if step % task.every == 0:
            curve.append(evaluate(task, act))
    return curve


def baseline(task: Task, seed: int) -> Curve:
    curve: Curve = []

    class Evaluation(BaseCallback):
        def _on_step(self) -> bool:
            if self.num_timesteps % task.every == 0:
                curve.append(evaluate(task, lambda o: self.model.predict(o, deterministic=True)[0]))
            return True

    env = task.make()
    assert env.action_space.shape is not None
    size = env.action_space.shape[0]
    model = BaselineTD3(
        "MlpPolicy", env, learning_rate=RATE, buffer_size=task.steps, learning_starts=task.warm_up,
        batch_size=BATCH, gamma=task.gamma, train_freq=1, gradient_steps=1, seed=seed, device="cpu",
        action_noise=NormalActionNoise(np.zeros(size), np.full(size, SIGMA)), policy_kwargs={"net_arch": [*HIDDEN]},
    )  # fmt: skip
    model.learn(task.steps, callback=Evaluation())
    return curve


LEARNERS: dict[str, Callable[[Task, int], Curve]] = {
    "stable-baselines3": baseline,
    "appl_dist fp32": partial(ours, precision="fp32"),
    "appl_dist bf16": partial(ours, precision="bf16"),
}


def interquartile_mean(curves: np.ndarray, seed: int = 0) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Interquartile mean and 95 % band of curves (seeds, points): percentile bootstrap over seeds."""
    picks = np.random.default_rng(seed).integers(len(curves), size=(RESAMPLES, len(curves)))
    means = trim_mean(curves[picks], 0.25, axis=1)  # (resamples, points)
    low, high = np.percentile(means, [2.5, 97.5], axis=0)
    return trim_mean(curves, 0.25, axis=0), low, high


Runs = dict[tuple[str, str], list[dict[str, Any]]]  # (task, learner) -> its finished runs


def finished(path: Path) -> Runs:
    runs: Runs = {}
    for line in path.read_text().splitlines() if path.exists() else []:
        run = json.loads(line)
        runs.setdefault((run["task"], run["learner"]), []).append(run)
    return runs


def draw(tasks: list[Task], runs: Runs, path: Path) -> None:
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(4.2 * len(tasks), 3.4), layout="constrained")
    FigureCanvasAgg(figure)
    for axes, task in zip(figure.subplots(1, len(tasks), squeeze=False)[0], tasks, strict=True):
        for name in LEARNERS:
            curves = np.array([run["returns"] for run in runs.get((task.name, name), [])])
            if not len(curves):
                continue
            middle, low, high = interquartile_mean(curves)
            steps = task.every * np.arange(1, len(middle) + 1)
            (line,) = axes.plot(steps, middle, label=f"{name} ({len(curves)} seeds)", linewidth=1.5)
            axes.fill_between(steps, low, high, color=line.get_color(), alpha=0.15, linewidth=0)
        axes.set_xlabel("environment steps")
        axes.set_ylabel("return without noise")
        axes.set_title(task.name, fontsize=10)
        axes.legend(frameon=False, fontsize=8)
    figure.savefig(path, dpi=160)


def table(tasks: list[Task], runs: Runs) -> str:
    lines = [
        "| task | learner | seeds | last evaluation, IQM [95 %] | worst seed | mean of the run, IQM [95 %] | minutes |",
        "|---|---|---|---|---|---|---|",
    ]
    for task in tasks:
        for name in LEARNERS:
            found = runs.get((task.name, name), [])
            if not found:
                continue
            curves = np.array([run["returns"] for run in found])
            (last,), (last_low,), (last_high,) = interquartile_mean(curves[:, -1:])
            (mean,), (low,), (high,) = interquartile_mean(curves.mean(1, keepdims=True))
            minutes = np.mean([run["seconds"] for run in found]) / 60
            lines.append(
                f"| {task.name} | {name} | {len(found)} | {last:.0f} [{last_low:.0f}, {last_high:.0f}] "
                f"| {curves[:, -1].min():.0f} | {mean:.0f} [{low:.0f}, {high:.0f}] | {minutes:.1f} |"
            )
    return "\n".join(lines) + "\n"


def main() -> None:
    parser = argparse.ArgumentParser(description="Learning curves of the learner core and of stable-baselines3's TD3.")
    names = [task.name for task in TASKS]
    parser.add_argument("--tasks", nargs="+", choices=names, default=names)
    parser.add_argument("--learners", nargs="+", choices=list(LEARNERS), default=list(LEARNERS))
    parser.add_argument("--seeds", type=int, help="instead of 5 for Pendulum and 3 for the others")
    parser.add_argument("--steps", type=int, help="instead of 8,000 for Pendulum and 30,000 for the others")
    parser.add_argument("--out", type=Path, default=Path("outputs/td3_tasks"))
    args = parser.parse_args()
    torch.set_num_threads(1)
    args.out.mkdir(parents=True, exist_ok=True)
    results = args.out / "runs.jsonl"
    chosen = [task for task in TASKS if task.name in args.tasks]
    if args.steps:
        chosen = [Task(**{**vars(task), "steps": args.steps}) for task in chosen]
    # Seed by seed, so that an early end leaves every learner with as many seeds.
    most = max(args.seeds or task.seeds for task in chosen)
    for seed, task, name in itertools.product(range(most), chosen, args.learners):
        done = any(run["seed"] == seed for run in finished(results).get((task.name, name), []))
        if done or seed >= (args.seeds or task.seeds):
            continue
        began = time.perf_counter()
        returns = LEARNERS[name](task, seed)
        run = {"task": task.name, "learner": name, "seed": seed, "returns": returns}
        with open(results, "a", encoding="utf-8") as file:
            file.write(json.dumps({**run, "seconds": time.perf_counter() - began}) + "\n")
        print(f"{task.name} seed {seed}  {name:18s} {returns[-1]:8.1f}", flush=True)
    runs = finished(results)
    print(table(chosen, runs))
    (args.out / "table.md").write_text(table(chosen, runs), encoding="utf-8")
    draw(chosen, runs, args.out / "curves.png")


if __name__ == "__main__":
    main()
