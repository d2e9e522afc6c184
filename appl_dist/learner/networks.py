"""The policy and the two critics of TD3 as torch modules.

Parameters are float32. With `bf16` the hidden layers run under autocast in bfloat16; the output layer, whose rounding
would show in Q-values and actions, always computes in float32.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from contextlib import nullcontext

import torch
from torch import Tensor, nn
from torch.nn import functional


class MLP(nn.Module):
    """ReLU layers of widths `sizes` (input first, output last), initialised as torch.nn.Linear is.

    layer_norm: normalise before every ReLU (Ba et al., 2016; without gains).
    """

    def __init__(self, sizes: Sequence[int], *, bf16: bool, layer_norm: bool = False) -> None:
        super().__init__()
        self.layers = nn.ModuleList(nn.Linear(i, o) for i, o in itertools.pairwise(sizes))
        self.bf16, self.layer_norm = bf16, layer_norm

    def linears(self) -> list[nn.Linear]:
        """The layers, input to output."""
        return [layer for layer in self.layers if isinstance(layer, nn.Linear)]

    def forward(self, *inputs: Tensor) -> Tensor:
        """(b, out) float32 of inputs (b, k) side by side.

        The first layer's weights are cut rather than the inputs joined: a gradient by one of several inputs, as the
        policy's by the action, then costs nothing for the others, 720 beams among them.
        """
        first, *others, output = self.linears()
        with torch.autocast(inputs[0].device.type, torch.bfloat16) if self.bf16 else nullcontext():
            weights = first.weight.split([x.shape[1] for x in inputs], 1)
            x = functional.linear(inputs[0], weights[0], first.bias)
            for more, weight in zip(inputs[1:], weights[1:], strict=True):
                x = x + functional.linear(more, weight)
            x = self._activate(x)
            for layer in others:
                x = self._activate(layer(x))
        value: Tensor = output(x.float())
        return value

    def _activate(self, x: Tensor) -> Tensor:
        return functional.layer_norm(x, x.shape[-1:]).relu_() if self.layer_norm else x.relu_()


class Actor(nn.Module):
    """The deterministic policy: observations (b, obs) to actions (b, act) in [-1, 1]."""

    def __init__(self, sizes: Sequence[int], *, bf16: bool) -> None:
        super().__init__()
        self.mlp = MLP(sizes, bf16=bf16)

    def forward(self, observation: Tensor) -> Tensor:
        action: Tensor = self.mlp(observation).tanh()
        return action


class TwinCritic(nn.Module):
    """Two independent critics Q1 and Q2 of observations (b, obs) and actions (b, act)."""

    def __init__(self, sizes: Sequence[int], *, bf16: bool, layer_norm: bool) -> None:
        super().__init__()
        self.q1 = MLP(sizes, bf16=bf16, layer_norm=layer_norm)
        self.q2 = MLP(sizes, bf16=bf16, layer_norm=layer_norm)

    def forward(self, observation: Tensor, action: Tensor) -> Tensor:
        """(2, b) both values."""
        x = torch.cat((observation, action), 1)
        return torch.cat((self.q1(x), self.q2(x)), 1).t()

    def first(self, observation: Tensor, action: Tensor) -> Tensor:
        """(b,) the value of Q1 alone, which the policy climbs."""
        value: Tensor = self.q1(observation, action)
        return value[:, 0]
