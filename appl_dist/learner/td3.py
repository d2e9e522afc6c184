"""Twin delayed deep deterministic policy gradient (Fujimoto et al., ICML 2018, Algorithm 1), as APPLR uses it.

Input: batches of n-step transitions from replay. Output: the policy's layers, and metrics. Where the APPL papers give
a value (networks, journal Sec. V-D) the settings follow them, elsewhere the TD3 paper.
"""

from __future__ import annotations

import copy
import logging
import math
from collections.abc import Callable
from typing import Any

import numpy as np
import torch
from torch import Tensor, nn

from appl_dist.errors import UserError
from appl_dist.learner.cuda_graph import GraphedStep
from appl_dist.learner.networks import Actor, TwinCritic
from appl_dist.learner.row_layout import Batch
from appl_dist.learner.settings import TD3Settings
from appl_dist.spec import FloatArray

log = logging.getLogger(__name__)

Metrics = dict[str, Tensor]  # 0-d tensors: reading one waits for the device, so read them rarely
Step = Callable[..., Metrics]


class Diverged(Exception):
    """A loss or gradient is no longer finite; the caller says which checkpoint to go back to."""


class TD3:
    """The networks, their targets and optimisers. The same seed and batches give the same bits.

    obs_size, action_size: entries of an observation and of an action. seed: of initial weights and target noise.
    """

    def __init__(
        self, settings: TD3Settings, obs_size: int, action_size: int, seed: int | np.random.SeedSequence = 0
    ) -> None:
        self.settings = settings
        torch.set_num_threads(settings.threads)
        self.device = _usable(settings.device)
        self.precision = _precision(settings.precision, self.device)
        bf16 = self.precision == "bf16"
        sequence = seed if isinstance(seed, np.random.SeedSequence) else np.random.SeedSequence(seed)
        initial, noise = (int(state) for state in sequence.generate_state(2, np.uint64) >> np.uint64(1))
        with torch.random.fork_rng(devices=[]):  # drawn on the CPU: the same for any device
            torch.manual_seed(initial)
            self.actor = Actor((obs_size, *settings.hidden, action_size), bf16=bf16).to(self.device)
            sizes = (obs_size + action_size, *settings.hidden, 1)
            self.critic = TwinCritic(sizes, bf16=bf16, layer_norm=settings.layer_norm).to(self.device)
        self.actor_target = copy.deepcopy(self.actor).requires_grad_(False)
        self.critic_target = copy.deepcopy(self.critic).requires_grad_(False)
        self.actor_optimiser = _adam(self.actor, settings.actor_lr)
        self.critic_optimiser = _adam(self.critic, settings.critic_lr)
        self.noise = torch.Generator(self.device).manual_seed(noise)  # of target policy smoothing
        self.updates = 0
        self.errors = torch.empty(0)  # (b,) absolute TD errors of the last batch, for a prioritised replay
        self._critic_step: Step = self._update_critics
        self._actor_step: Step = self._update_actor_and_targets
        if self.device.type == "cuda":
            self._critic_step, self._actor_step = GraphedStep(self._critic_step), GraphedStep(self._actor_step)
        log.info("TD3 on %s, %s, %d thread(s)", self.device, self.precision, settings.threads)

    def update(self, batch: Batch, detail: bool = False) -> Metrics:
        """One gradient step on both critics and, every `policy_delay` calls, one on the actor and all targets.

        detail: also norms and action saturation, worth a pass over all parameters. The metrics hold until the next
        update.
        """
        # Adam's moments of dead units decay into denormals, which are slow. The flag belongs to the calling thread,
        # for numpy too, so it is set for the update only.
        torch.set_flush_denormal(True)
        try:
            observation = self._to_device(batch.observations)
            weights = np.ones_like(batch.returns) if batch.weights is None else batch.weights
            arrays = (batch.actions, batch.returns, batch.discounts, batch.next_observations, weights)
            noise = torch.randn(batch.actions.shape, generator=self.noise, device=self.device)
            metrics = self._critic_step(observation, *(self._to_device(a) for a in arrays), noise)
            self.errors = metrics.pop("errors")
            self.updates += 1
            if self.updates % self.settings.policy_delay == 0:
                metrics |= self._actor_step(observation)
            return metrics | (self._detail(observation) if detail else {})
        finally:
            torch.set_flush_denormal(False)

    def _update_critics(
        self,
        observation: Tensor,
        action: Tensor,
        returns: Tensor,
        discount: Tensor,
        next_observation: Tensor,
        weight: Tensor,
        noise: Tensor,
    ) -> Metrics:
        """Minimise the weighted mean squared error of both critics to the common target."""
        target = self.target(returns, discount, next_observation, noise)  # (b,)
        value = self.critic(observation, action)  # (2, b)
        error = value - target
        loss = (weight * error.square()).mean(1).sum()
        self.critic_optimiser.zero_grad()
        loss.backward()
        self.critic_optimiser.step()
        with torch.no_grad():
            return {
                "loss/critic": loss.detach(),
                "q/mean": value.mean(),
                "q/std": value[0].std(correction=0),
                "q/target_mean": target.mean(),
                "q/td_error": error.abs().mean(),
                "errors": error.detach().abs().amax(0),
            }

    @torch.no_grad()
    def target(self, returns: Tensor, discount: Tensor, next_observation: Tensor, noise: Tensor) -> Tensor:
        """(b,) y = R_n + gamma^k min_i Q'_i(s', clip(pi'(s') + clip(noise))), TD3 paper eq. 14.

        noise (b, act): standard normal.
        """
        s = self.settings
        smoothing = (noise * s.target_noise).clamp(-s.target_noise_clip, s.target_noise_clip)
        next_action = (self.actor_target(next_observation) + smoothing).clamp(-1.0, 1.0)
        next_value: Tensor = self.critic_target(next_observation, next_action)
        return returns + discount * next_value.amin(0)

    def _update_actor_and_targets(self, observation: Tensor) -> Metrics:
        """One step up Q1 along the deterministic policy gradient, then Polyak averaging of all targets."""
        loss = -self.critic.first(observation, self.actor(observation)).mean()
        self.actor_optimiser.zero_grad()
        loss.backward(inputs=list(self.actor.parameters()))  # the critics stay as they are
        self.actor_optimiser.step()
        self.average_targets()
        return {"loss/actor": loss.detach()}

    @torch.no_grad()
    def average_targets(self) -> None:
        """target <- tau net + (1 - tau) target."""
        for target, net in ((self.actor_target, self.actor), (self.critic_target, self.critic)):
            torch._foreach_lerp_(list(target.parameters()), list(net.parameters()), self.settings.polyak)

    @torch.no_grad()
    def _detail(self, observation: Tensor) -> Metrics:
        """Norms of parameters and of the last gradients; the share of each action beyond 0.99."""
        metrics = {}
        for name, net in (("actor", self.actor), ("critic", self.critic)):
            parameters = list(net.parameters())
            gradients = [p.grad for p in parameters if p.grad is not None] or [torch.zeros((), device=self.device)]
            metrics[f"norm/{name}"] = nn.utils.get_total_norm(parameters)
            metrics[f"norm/{name}_gradient"] = nn.utils.get_total_norm(gradients)
        saturated = (self.actor(observation).abs() > 0.99).float().mean(0)  # (act,)
        return metrics | {f"saturation/{i}": share for i, share in enumerate(saturated)}

    def _to_device(self, array: FloatArray) -> Tensor:
        """The array on the device. For CUDA through pinned memory, so that nothing here waits for the copy."""
        tensor = torch.from_numpy(array)
        return tensor.pin_memory().to(self.device, non_blocking=True) if self.device.type == "cuda" else tensor

    # ---- export and restore

    def policy_arrays(self) -> tuple[tuple[FloatArray, ...], tuple[FloatArray, ...]]:
        """Copies of the actor's weights (out, in) and biases (out,), float32, as PolicyFile wants them."""
        layers = self.actor.mlp.linears()
        weights = tuple(layer.weight.detach().cpu().numpy().copy() for layer in layers)
        biases = tuple(layer.bias.detach().cpu().numpy().copy() for layer in layers)
        return weights, biases

    def state(self) -> tuple[dict[str, Tensor], dict[str, Any]]:
        """Every tensor and plain number that `update` depends on. The tensors are the live ones: copy them."""
        tensors = {
            f"{name}.{key}": tensor
            for name in ("actor", "critic", "actor_target", "critic_target")
            for key, tensor in getattr(self, name).state_dict().items()
        }
        for name, net, optimiser in self._optimisers():
            for key, parameter in net.named_parameters():
                for moment, tensor in optimiser.state[parameter].items():
                    tensors[f"{name}_optimiser.{key}.{moment}"] = tensor
        return tensors | {"noise": self.noise.get_state()}, {"updates": self.updates}

    @torch.no_grad()
    def load_state(self, tensors: dict[str, Tensor], numbers: dict[str, Any]) -> None:
        """Continue from what `state` returned; ValueError names the first tensor that differs in name or shape."""
        own, _ = self.state()
        for name in sorted(own.keys() | tensors.keys()):
            shapes = [tuple(t[name].shape) if name in t else None for t in (tensors, own)]
            if shapes[0] != shapes[1]:
                raise ValueError(f"networks: {name} has shape {shapes[0]} there; the settings ask for {shapes[1]}")
        for name, tensor in own.items():
            if name != "noise":
                tensor.copy_(tensors[name])
        self.noise.set_state(tensors["noise"].cpu())
        self.updates = int(numbers["updates"])

    def _optimisers(self) -> tuple[tuple[str, nn.Module, torch.optim.Adam], ...]:
        return (("actor", self.actor, self.actor_optimiser), ("critic", self.critic, self.critic_optimiser))


def read(metrics: Metrics) -> dict[str, float]:
    """The metrics as numbers. Diverged names the first that is not finite."""
    numbers = {name: float(value) for name, value in metrics.items()}
    for name, value in numbers.items():
        if not math.isfinite(value):
            raise Diverged(f"{name} is {value}")
    return numbers


def _adam(net: nn.Module, rate: float) -> torch.optim.Adam:
    """Fused Adam whose moments exist from the start, so that a checkpoint always holds the same tensors."""
    parameters = list(net.parameters())
    device = parameters[0].device
    optimiser = torch.optim.Adam(parameters, rate, fused=True, capturable=device.type == "cuda")
    for p in parameters:
        optimiser.state[p] = {
            "step": torch.zeros((), device=device),
            "exp_avg": torch.zeros_like(p, requires_grad=False),
            "exp_avg_sq": torch.zeros_like(p, requires_grad=False),
        }
    return optimiser


def _usable(device: str) -> torch.device:
    """The device, once it has proved to hold a number."""
    try:
        return torch.zeros(1, device=device).device
    except (RuntimeError, AssertionError) as e:  # torch without CUDA asserts
        reason = str(e).splitlines()[0]
        raise UserError(f"learner.td3.device: {device!r} cannot be used: {reason}; allowed cpu, cuda, cuda:N") from None


def _precision(asked: str, device: torch.device) -> str:
    """`auto` as bf16 where the hardware multiplies bfloat16, else fp32; a warning where bf16 would be emulated."""
    if device.type == "cuda":
        native = torch.cuda.is_bf16_supported(including_emulation=False)
    else:
        native = torch.cpu._is_amx_tile_supported() or torch.cpu._is_avx512_bf16_supported()
    if asked == "bf16" and not native:
        log.warning(
            "learner.td3.precision: bf16 is emulated on %s, many times slower than fp32; use auto or fp32", device
        )
    return asked if asked != "auto" else "bf16" if native else "fp32"
