"""Twin delayed deep deterministic policy gradient (Fujimoto et al., ICML 2018, Alg. 1), as APPLR uses it.

Comes in: batches of n-step transitions from replay. Goes out: the policy's layers, and metrics. One call of
`update` is one gradient step on both critics and, every `policy_delay` calls, one on the actor followed by
Polyak averaging of all targets. The settings' defaults are the paper's where it gives them (networks, Sec.
V-D of the journal) and those of the TD3 paper elsewhere.
"""

from __future__ import annotations

import copy
import logging
import math
from typing import Any

import torch
from torch import Tensor

from appl_dist.errors import UserError
from appl_dist.learner.networks import FlatMLP
from appl_dist.learner.optimiser import Adam, average
from appl_dist.learner.products import tiled
from appl_dist.learner.row_layout import Batch
from appl_dist.learner.settings import TD3Settings
from appl_dist.learner.workers import Workers
from appl_dist.spec import FloatArray

log = logging.getLogger(__name__)

Metrics = dict[str, Tensor]  # 0-d tensors: reading one waits for the device, so read them rarely


class Diverged(Exception):
    """A loss or gradient is no longer finite; the caller says which checkpoint to go back to."""


class TD3:
    """The learner's networks, targets and optimisers. Same seed and batches: bit-equal results."""

    def __init__(self, settings: TD3Settings, obs_size: int, action_size: int, seed: int = 0) -> None:
        self.settings = settings
        torch.set_num_threads(settings.threads)
        self.device = _usable(settings.device)
        self.precision = _resolve(settings.precision, self.device)
        dtype = torch.bfloat16 if self.precision == "bf16" else torch.float32
        # In an update. Where our own threads share the products, torch's would only get in their way.
        self._torch_threads = 1 if tiled(dtype, self.device) else settings.threads
        self._workers = Workers(settings.threads)
        initial = torch.Generator().manual_seed(seed)
        self.noise = torch.Generator(self.device).manual_seed(seed + 1)  # target smoothing
        actor_sizes = (obs_size, *settings.hidden, action_size)
        critic_sizes = (obs_size + action_size, *settings.hidden, 1)
        self.actor = FlatMLP(actor_sizes, 1, initial, self.device, dtype, workers=self._workers)
        self.critic = FlatMLP(critic_sizes, 2, initial, self.device, dtype, settings.layer_norm, self._workers)
        self.actor_target = copy.deepcopy(self.actor)
        self.critic_target = copy.deepcopy(self.critic)
        self.actor_adam = Adam(self.actor, settings.actor_lr, self._workers)
        self.critic_adam = Adam(self.critic, settings.critic_lr, self._workers)
        self.updates = 0
        self.errors = torch.empty(0)
        log.info("TD3 on %s, %s, %d thread(s)", self.device, self.precision, settings.threads)

    def update(self, batch: Batch, detail: bool = False) -> Metrics:
        """One training step. `detail` adds norms and action saturation, worth a pass over all parameters."""
        # Adam's moments of dead units decay into denormals, which are slow. The flag is the calling thread's,
        # for numpy too, so it is on for the update only.
        torch.set_flush_denormal(True)
        threads = torch.get_num_threads()
        torch.set_num_threads(self._torch_threads)
        try:
            return self._update(batch, detail)
        finally:
            torch.set_num_threads(threads)
            torch.set_flush_denormal(False)

    def _update(self, batch: Batch, detail: bool) -> Metrics:
        obs, action, returns, discounts, next_obs = (
            torch.from_numpy(a).to(self.device)
            for a in (
                batch.observations,
                batch.actions,
                batch.returns,
                batch.discounts,
                batch.next_observations,
            )
        )
        targets = self.targets(returns, discounts, next_obs)  # (b,)
        done = self.critic.forward(obs, action)
        error = done.output[..., 0] - targets  # (2, b)
        by_output = error * (2.0 / len(targets))
        if batch.weights is not None:
            by_output *= torch.from_numpy(batch.weights).to(self.device)
        self.critic.backward(done, by_output[..., None])
        self.critic_adam.step()
        self.updates += 1
        self.errors = error.abs().amax(0)  # (b,) of the last batch, for a prioritised replay
        metrics: Metrics = {
            "loss/critic": error.square().mean(1).sum(),  # the sum of both networks' mean squared errors
            "q/mean": done.output.mean(),
            "q/std": done.output[0].std(correction=0),
            "q/target_mean": targets.mean(),
            "q/td_error": error.abs().mean(),
        }
        if self.updates % self.settings.policy_delay == 0:
            metrics["loss/actor"] = self._improve_policy(obs)
            self._average_targets()
        if detail:
            metrics |= self._detail(obs)
        return metrics

    def _improve_policy(self, obs: Tensor) -> Tensor:
        """One step up the first critic's value of the actor's own actions, TD3 paper eq. 6; its loss."""
        done = self.actor.forward(obs)
        chosen = done.output[0].tanh()  # (b, act)
        value = self.critic.forward(obs, chosen, heads=1)
        down = torch.full_like(value.output, -1.0 / len(obs))  # the loss is -mean Q
        by_action = self.critic.input_gradient(value, down, chosen.shape[1])
        self.actor.backward(done, (by_action * (1.0 - chosen.square()))[None])
        self.actor_adam.step()
        return -value.output.mean()

    def targets(self, returns: Tensor, discounts: Tensor, next_obs: Tensor) -> Tensor:
        """(b,) y = R_n + gamma^k min_i Q'_i(s', clip(pi'(s') + clip(noise))), TD3 paper eq. 14."""
        s = self.settings
        action = self.actor_target.forward(next_obs).output[0].tanh()
        noise = torch.randn(action.shape, generator=self.noise, device=self.device) * s.target_noise
        noise.clamp_(-s.target_noise_clip, s.target_noise_clip)
        action = (action + noise).clamp_(-1.0, 1.0)
        q = self.critic_target.forward(next_obs, action).output[..., 0]
        return returns + discounts * q.amin(0)

    def _average_targets(self) -> None:
        average(self.actor_target, self.actor, self.settings.polyak, self._workers)
        average(self.critic_target, self.critic, self.settings.polyak, self._workers)

    def _detail(self, obs: Tensor) -> Metrics:
        saturated = (self.actor.forward(obs).output[0].tanh().abs() > 0.99).float().mean(0)  # (act,)
        return {
            "norm/actor": self.actor.flat.norm(),
            "norm/critic": self.critic.flat.norm(),
            "norm/actor_gradient": self.actor.gradient_norm(),
            "norm/critic_gradient": self.critic.gradient_norm(),
            **{f"saturation/{i}": share for i, share in enumerate(saturated)},
        }

    # ---- out, and back in

    def policy_arrays(self) -> tuple[tuple[FloatArray, ...], tuple[FloatArray, ...]]:
        """Copies of the actor's weights (out, in) and biases (out,), float32, as PolicyFile wants them."""
        weights = tuple(w[0].t().contiguous().cpu().numpy() for w, _ in self.actor.master)
        biases = tuple(b[0, 0].clone().cpu().numpy() for _, b in self.actor.master)
        return weights, biases

    def state(self) -> tuple[dict[str, Tensor], dict[str, Any]]:
        """Every tensor and plain number that `update` depends on. The tensors are the live ones: copy them."""
        tensors = {
            f"{name}.flat": getattr(self, name).flat for name in ("actor", "critic", "actor_target", "critic_target")
        }
        for name, adam in self._optimisers():
            tensors |= {f"{name}.first": adam.first, f"{name}.second": adam.second}
        tensors["noise"] = self.noise.get_state()
        steps = [adam.steps for _, adam in self._optimisers()]
        return tensors, {"updates": self.updates, "steps": steps, "sizes": [self.actor.sizes, self.critic.sizes]}

    def load_state(self, tensors: dict[str, Tensor], numbers: dict[str, Any]) -> None:
        """Continue from what `state` gave; ValueError if the networks differ."""
        sizes = [list(self.actor.sizes), list(self.critic.sizes)]
        found = [list(s) for s in numbers["sizes"]]
        if found != sizes:
            raise ValueError(f"networks: the state has layers {found}; the settings ask for {sizes}")
        for name in ("actor", "critic", "actor_target", "critic_target"):
            net: FlatMLP = getattr(self, name)
            net.flat.copy_(tensors[f"{name}.flat"])
            net.refresh()
        for (name, adam), steps in zip(self._optimisers(), numbers["steps"], strict=True):
            adam.first.copy_(tensors[f"{name}.first"])
            adam.second.copy_(tensors[f"{name}.second"])
            adam.steps = int(steps)
        self.noise.set_state(tensors["noise"].cpu())
        self.updates = int(numbers["updates"])

    def _optimisers(self) -> tuple[tuple[str, Adam], ...]:
        return (("actor_adam", self.actor_adam), ("critic_adam", self.critic_adam))


def read(metrics: Metrics) -> dict[str, float]:
    """The metrics as numbers. Diverged names the first that is not finite."""
    numbers = {name: float(value) for name, value in metrics.items()}
    for name, value in numbers.items():
        if not math.isfinite(value):
            raise Diverged(f"{name} is {value}")
    return numbers


def _usable(device: str) -> torch.device:
    """The device, once it has proved to hold a number."""
    try:
        return torch.zeros(1, device=device).device
    except (RuntimeError, AssertionError) as e:  # torch without CUDA asserts
        reason = str(e).splitlines()[0]
        raise UserError(f"learner.td3.device: {device!r} cannot be used: {reason}; allowed cpu, cuda, cuda:N") from None


def _resolve(precision: str, device: torch.device) -> str:
    """`auto` as bf16 where the hardware multiplies it natively, else fp32."""
    if precision != "auto":
        return precision
    if device.type == "cuda":
        return "bf16" if torch.cuda.is_bf16_supported(including_emulation=False) else "fp32"
    # Without AMX or AVX512-BF16 bfloat16 is emulated and slower than float32.
    native = torch.cpu._is_amx_tile_supported() or torch.cpu._is_avx512_bf16_supported()
    return "bf16" if native else "fp32"
