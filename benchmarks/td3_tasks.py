"""Does the learner core learn what stable-baselines3's TD3 learns? Pendulum-v1, same hyper-parameters.

One update per step for all; evaluation without noise on the same 10 starts. Writes curves.csv, curves.png
and table.md to --out.

    python benchmarks/td3_tasks.py [--seeds 3] [--steps 6000] [--out outputs/td3_tasks]
"""

from __future__ import annotations

import argparse
import csv
from collections.abc import Callable
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import torch
from stable_baselines3 import TD3 as BaselineTD3
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.noise import NormalActionNoise

from appl_dist.learner.replay import Replay
from appl_dist.learner.settings import TD3Settings
from appl_dist.learner.td3 import TD3
from appl_dist.spec import Rollout

TASK, TORQUE = "Pendulum-v1", 2.0
HIDDEN, RATE, BATCH, GAMMA, SIGMA, WARM_UP = (256, 256), 1e-3, 256, 0.98, 0.1, 500
EVERY, EPISODES = 500, 10
RUN = 10  # steps in one rollout; the pendulum never terminates, so every rollout is cut short

Curve = list[tuple[int, float]]  # steps, mean return of the evaluation
Act = Callable[[Any], Any]  # observation -> action in [-1, 1]


def evaluate(act: Act) -> float:
    """Mean return over the same starts each time."""
    env = gymnasium.make(TASK)
    total = 0.0
    for seed in range(EPISODES):
        obs, _ = env.reset(seed=10_000 + seed)
        over = False
        while not over:
            obs, reward, terminal, truncated, _ = env.step(TORQUE * act(obs))
            total += float(reward)
            over = terminal or truncated
    return total / EPISODES


def ours(seed: int, steps: int, precision: str) -> Curve:
    settings = TD3Settings(hidden=HIDDEN, batch_size=BATCH, actor_lr=RATE, critic_lr=RATE, precision=precision)
    learner = TD3(settings, 3, 1, seed=seed)
    replay = Replay(None, steps + RUN, 1, GAMMA, observation_size=3, scan_size=0, action_size=1)
    rng = np.random.default_rng(seed)
    env = gymnasium.make(TASK)

    def act(obs: Any) -> Any:
        return learner.actor.forward(torch.from_numpy(obs[None])).output[0, 0].tanh().numpy()

    curve: Curve = []
    obs, _ = env.reset(seed=seed)
    observations, actions, rewards = [obs], [], []
    for step in range(1, steps + 1):
        if step <= WARM_UP:
            action = rng.uniform(-1, 1, 1).astype(np.float32)
        else:
            action = np.clip(act(obs) + SIGMA * rng.standard_normal(1, np.float32), -1, 1)
        obs, reward, _, truncated, _ = env.step(TORQUE * action)
        observations.append(obs)
        actions.append(action)
        rewards.append(float(reward))
        if len(rewards) == RUN or truncated:
            rollout = Rollout(np.stack(observations), np.stack(actions), np.array(rewards, np.float32), False, {})
            replay.insert(rollout, "task", replay.expected_seq("task"))
            if truncated:
                obs, _ = env.reset()
            observations, actions, rewards = [obs], [], []
        if step > WARM_UP:
            learner.update(replay.sample(BATCH, rng))
        if step % EVERY == 0:
            curve.append((step, evaluate(act)))
    return curve


class _Evaluation(BaseCallback):
    def __init__(self) -> None:
        super().__init__()
        self.curve: Curve = []

    def _on_step(self) -> bool:
        if self.num_timesteps % EVERY == 0:
            self.curve.append(
                (
                    self.num_timesteps,
                    evaluate(lambda o: self.model.predict(o, deterministic=True)[0] / TORQUE),
                )
            )
        return True


def baseline(seed: int, steps: int) -> Curve:
    model = BaselineTD3(
        "MlpPolicy", gymnasium.make(TASK), learning_rate=RATE, buffer_size=steps, learning_starts=WARM_UP,
        batch_size=BATCH, gamma=GAMMA, train_freq=1, gradient_steps=1, seed=seed, device="cpu",
        action_noise=NormalActionNoise(np.zeros(1), np.full(1, SIGMA)), policy_kwargs={"net_arch": [*HIDDEN]},
    )  # fmt: skip
    evaluation = _Evaluation()
    model.learn(steps, callback=evaluation)
    return evaluation.curve


def draw(curves: dict[str, list[Curve]], path: Path) -> None:
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(6.5, 3.5), layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.subplots()
    for name, runs in curves.items():
        steps = [s for s, _ in runs[0]]
        returns = np.array([[r for _, r in run] for run in runs])
        (line,) = axes.plot(steps, returns.mean(0), label=name, linewidth=1.5)
        axes.fill_between(steps, returns.min(0), returns.max(0), color=line.get_color(), alpha=0.15)
    axes.set_xlabel("environment steps")
    axes.set_ylabel("return without noise")
    axes.set_title(f"{TASK}: mean, lowest and highest of {len(runs)} seeds", fontsize=10)
    axes.legend(frameon=False)
    figure.savefig(path, dpi=160)


def main() -> None:
    parser = argparse.ArgumentParser(description="Pendulum-v1: the learner core against stable-baselines3.")
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--steps", type=int, default=6000)
    parser.add_argument("--out", type=Path, default=Path("outputs/td3_tasks"))
    args = parser.parse_args()
    torch.set_num_threads(1)
    learners: dict[str, Callable[[int], Curve]] = {
        "stable-baselines3": lambda seed: baseline(seed, args.steps),
        "appl_dist fp32": lambda seed: ours(seed, args.steps, "fp32"),
        "appl_dist bf16": lambda seed: ours(seed, args.steps, "bf16"),
    }
    args.out.mkdir(parents=True, exist_ok=True)
    curves: dict[str, list[Curve]] = {name: [] for name in learners}
    for seed in range(args.seeds):
        for name, learn in learners.items():
            curves[name].append(learn(seed))
            print(f"seed {seed}  {name:18s} {curves[name][-1][-1][1]:8.1f}", flush=True)
    with open(args.out / "curves.csv", "w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow(["learner", "seed", "step", "return"])
        for name, runs in curves.items():
            writer.writerows([name, seed, *row] for seed, run in enumerate(runs) for row in run)
    lines = [
        "| learner | last evaluation, mean | lowest seed | highest seed | first above -200, steps |",
        "|---|---|---|---|---|",
    ]
    for name, runs in curves.items():
        last = [run[-1][1] for run in runs]
        solved = [next((s for s, r in run if r > -200), None) for run in runs]
        when = ", ".join("never" if s is None else str(s) for s in solved)
        lines.append(f"| {name} | {np.mean(last):.0f} | {min(last):.0f} | {max(last):.0f} | {when} |")
    table = "\n".join(lines) + "\n"
    (args.out / "table.md").write_text(table, encoding="utf-8")
    print(table)
    draw(curves, args.out / "curves.png")


if __name__ == "__main__":
    main()
