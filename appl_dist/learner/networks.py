"""Multilayer perceptrons for TD3: one flat float32 vector each, and twins evaluated as one.

All parameters of a network are views of one flat vector, so Adam, Polyak averaging, casting, norms and
checkpoints are single operations on it. `heads` networks of one shape (the twin Q-functions) run as batched
matrix products. With bfloat16 the hidden layers compute from a cast copy; the output layer, whose rounding
would show in Q-values and actions, and everything that accumulates (parameters, gradients into Adam,
targets) stay float32.

The backward pass is written out (a chain of matrix products, tested against autograd): gradients go straight
into the optimiser's vector, and the actor's loss is differentiated by the action alone, not by 729
observation entries and the critic's weights.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import torch
from torch import Tensor


class Layer(NamedTuple):
    weight: Tensor  # (heads, in, out)
    bias: Tensor  # (heads, 1, out)


class Pass(NamedTuple):
    """What a forward pass leaves for the backward pass."""

    inputs: list[Tensor]  # of each layer, (heads, b, in)
    output: Tensor  # (heads, b, out) float32


class FlatMLP:
    """`heads` ReLU networks with layer widths `sizes` (input first), initialised like torch.nn.Linear.

    `flat` (P,) float32 owns the numbers, `flat.grad` their gradients. After changing `flat` call `refresh`.
    """

    def __init__(
        self,
        sizes: Sequence[int],
        heads: int,
        generator: torch.Generator,
        device: torch.device,
        dtype: torch.dtype,
    ) -> None:
        self.sizes, self.heads, self.dtype = tuple(sizes), heads, dtype
        pairs = list(zip(self.sizes[:-1], self.sizes[1:], strict=True))
        self.flat = torch.zeros(sum(heads * (i + 1) * o for i, o in pairs), device=device)
        self.grad = torch.zeros_like(self.flat)
        self.flat.grad = self.grad
        self.master = self._views(self.flat)
        self._gradients = self._views(self.grad)
        for layer in self.master:
            bound = layer.weight.shape[1] ** -0.5
            for tensor in layer:
                drawn = torch.rand(tensor.shape, generator=generator)  # on the CPU: the same for any device
                tensor.copy_((2.0 * drawn - 1.0) * bound)
        last = heads * (pairs[-1][0] + 1) * pairs[-1][1]
        self._half = None if dtype == torch.float32 else self.flat[:-last].to(dtype)
        hidden = self.master[:-1] if self._half is None else self._views(self._half)
        self.layers = [*hidden, self.master[-1]]

    def _views(self, flat: Tensor) -> list[Layer]:
        """Layer views of `flat`, in order, as many as it holds."""
        views = []
        at = 0
        for i, o in zip(self.sizes[:-1], self.sizes[1:], strict=True):
            if at == len(flat):
                break
            middle, end = at + self.heads * i * o, at + self.heads * (i + 1) * o
            views.append(Layer(flat[at:middle].view(self.heads, i, o), flat[middle:end].view(self.heads, 1, o)))
            at = end
        return views

    def refresh(self) -> None:
        """Bring the cast copy up to date with `flat`."""
        if self._half is not None:
            self._half.copy_(self.flat[: len(self._half)])

    def forward(self, x: Tensor, heads: int | None = None) -> Pass:
        """Evaluate the first `heads` networks (all by default) on inputs x (b, in)."""
        h = self.heads if heads is None else heads
        y = x.to(self.layers[0].weight.dtype).expand(h, *x.shape)
        inputs = []
        for layer in self.layers[:-1]:
            inputs.append(y)
            y = torch.baddbmm(layer.bias[:h], y, layer.weight[:h]).relu_()
        inputs.append(y.float())
        last = self.layers[-1]
        return Pass(inputs, torch.baddbmm(last.bias[:h], inputs[-1], last.weight[:h]))

    def backward(self, done: Pass, gradient: Tensor) -> None:
        """Fill `grad` for a loss whose gradient by the output is `gradient` (heads, b, out) float32."""
        for i, g in self._descend(done, gradient):
            self._gradients[i].weight.copy_(torch.bmm(done.inputs[i].transpose(1, 2), g))
            torch.sum(g, 1, keepdim=True, dtype=torch.float32, out=self._gradients[i].bias)

    def input_gradient(self, done: Pass, gradient: Tensor, columns: int) -> Tensor:
        """(b, columns) float32: the loss's gradient by the last `columns` inputs; leaves `grad` alone."""
        *_, (_, g) = self._descend(done, gradient)
        weight = self.layers[0].weight[: len(g), -columns:]
        return torch.bmm(g, weight.transpose(1, 2)).float().sum(0)

    def _descend(self, done: Pass, gradient: Tensor) -> Iterator[tuple[int, Tensor]]:
        """From the last layer to the first: its number, and the loss's gradient by its output before ReLU."""
        g = gradient
        for i in reversed(range(len(self.layers))):
            yield i, g
            if i:
                layer, before = self.layers[i], self.layers[i - 1]
                g = torch.bmm(g, layer.weight[: len(g)].transpose(1, 2))
                # Where ReLU gave 0, the next layer's input is 0 and nothing flows back.
                g = torch.ops.aten.threshold_backward(g, done.inputs[i], 0).to(before.weight.dtype)
