"""What bfloat16 hidden layers change in a TD3 step: values and gradients at the same parameters and batches, Pendulum.

Trains in float32 on random actions, then computes targets, values and both gradients in float32 and in bfloat16, and
the values with one kind of number rounded at a time.

    python benchmarks/td3_precision.py [--updates 1500] [--batches 20]
"""

from __future__ import annotations

import argparse
from dataclasses import replace

import numpy as np
import torch
from torch import Tensor

from appl_dist.learner.networks import FlatMLP
from appl_dist.learner.replay import Replay
from appl_dist.learner.row_layout import Batch
from appl_dist.learner.settings import TD3Settings
from appl_dist.learner.td3 import TD3
from appl_dist.spec import Rollout
from benchmarks.td3_tasks import TASKS

NETWORKS = ("actor", "critic", "actor_target", "critic_target")


def collect(episodes: int, rng: np.random.Generator) -> Replay:
    task = TASKS[0]
    env = task.make()
    replay = Replay(None, 200 * episodes + 200, 1, task.gamma, observation_size=3, scan_size=0, action_size=1)
    for episode in range(episodes):
        observations = [env.reset(seed=episode)[0]]
        actions, rewards = [], []
        for _ in range(200):
            actions.append(rng.uniform(-1, 1, 1).astype(np.float32))
            observation, reward, *_ = env.step(actions[-1])
            observations.append(observation)
            rewards.append(float(reward))
        arrays = np.stack(observations), np.stack(actions), np.array(rewards, np.float32)
        replay.insert(Rollout(*arrays, False, {}), "task", episode)
    return replay


def step_quantities(learner: TD3, batch: Batch, seed: int) -> dict[str, Tensor]:
    """Everything a step computes before it moves a parameter."""
    learner.noise.manual_seed(seed)
    obs, action = torch.from_numpy(batch.observations), torch.from_numpy(batch.actions)
    arrays = (batch.returns, batch.discounts, batch.next_observations)
    targets = learner.targets(*(torch.from_numpy(a) for a in arrays))
    done = learner.critic.forward(obs, action)
    error = done.output[..., 0] - targets
    learner.critic.backward(done, error[..., None])
    acting = learner.actor.forward(obs)
    chosen = acting.output[0].tanh()
    value = learner.critic.forward(obs, chosen, heads=1)
    by_action = learner.critic.input_gradient(value, -torch.ones_like(value.output), 1)
    learner.actor.backward(acting, (by_action * (1.0 - chosen.square()))[None])
    return {
        "target": targets, "value": done.output[..., 0], "TD error": error,
        "critics' gradient": gradient(learner.critic), "action": chosen, "policy's gradient": gradient(learner.actor),
    }  # fmt: skip


def gradient(net: FlatMLP) -> Tensor:
    return torch.cat([part.grad.float() for part in net.parts])


def rounding(learner: TD3, batch: Batch) -> dict[str, float]:
    """Mean error of the first critic's values where only these numbers are rounded to bfloat16."""
    inputs = torch.cat([torch.from_numpy(batch.observations), torch.from_numpy(batch.actions)], 1)
    layers = [(layer.weight[0], layer.bias[0]) for layer in learner.critic.master]

    def values(rounded: str) -> Tensor:
        def kept(name: str, x: Tensor) -> Tensor:
            return x.bfloat16().float() if name == rounded else x

        x = kept("inputs", inputs)
        for weight, bias in layers[:-1]:
            x = kept("hidden units", torch.relu(x @ kept("weights", weight) + kept("weights", bias)))
        return x @ layers[-1][0] + layers[-1][1]

    wanted = values("nothing")
    return {name: float((values(name) - wanted).abs().mean()) for name in ("inputs", "weights", "hidden units")}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else "")
    parser.add_argument("--updates", type=int, default=1500)
    parser.add_argument("--batches", type=int, default=20)
    args = parser.parse_args()
    rng = np.random.default_rng(0)
    replay = collect(10, rng)
    settings = TD3Settings(hidden=(256, 256), actor_lr=1e-3, critic_lr=1e-3, precision="fp32")
    exact, half = TD3(settings, 3, 1), TD3(replace(settings, precision="bf16"), 3, 1)
    for _ in range(args.updates):
        exact.update(replay.sample(256, rng))
    for name in NETWORKS:
        getattr(half, name).flat.copy_(getattr(exact, name).flat)
        getattr(half, name).refresh()
    rows: dict[str, list[tuple[float, ...]]] = {}
    alone: dict[str, list[float]] = {}
    for seed in range(args.batches):
        batch = replay.sample(256, rng)
        wanted, found = step_quantities(exact, batch, seed), step_quantities(half, batch, seed)
        for name, moved in rounding(exact, batch).items():
            alone.setdefault(name, []).append(moved)
        for name, y in wanted.items():
            x = found[name]
            cosine = (x * y).sum() / (x.norm() * y.norm())
            rows.setdefault(name, []).append(
                tuple(float(v) for v in (y.abs().mean(), (x - y).abs().mean(), (x - y).mean(), cosine))
            )
    print(f"{'':20s} {'mean size':>12s} {'mean |error|':>14s} {'mean error':>12s} {'cosine':>8s}")
    for name, values in rows.items():
        size, error, bias, cosine = np.mean(values, axis=0)
        print(f"{name:20s} {size:12.4g} {error:14.2g} {bias:12.2g} {cosine:8.4f}")
    print("value, mean |error| where only these are rounded:", end=" ")
    print(", ".join(f"{name} {np.mean(errors):.2g}" for name, errors in alone.items()))


if __name__ == "__main__":
    main()
