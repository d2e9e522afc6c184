"""Multilayer perceptrons for TD3: one flat float32 vector each, and twins evaluated as one.

All parameters of a network are views of one flat vector, so Adam, Polyak averaging, norms and checkpoints are
single operations on it. `heads` networks of one shape (the twin Q-functions) run as batched matrix products.
With bfloat16 the hidden layers compute from a cast copy; the output layer, whose rounding would show in
Q-values and actions, and everything that accumulates (parameters, Adam's moments, targets) stay float32.

The backward pass is written out (a chain of matrix products, tested against autograd): gradients go straight
into the optimiser's vectors, and the actor's loss is differentiated by the action alone, not by 729
observation entries and the critic's weights. A network keeps the memory of its passes: fresh pages for every
product cost as much as the products.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import torch
from torch import Tensor

_NORM_EPSILON = 1e-5


class Layer(NamedTuple):
    weight: Tensor  # (heads, in, out)
    bias: Tensor  # (heads, 1, out)


class Part(NamedTuple):
    """A stretch of a network's parameters that computes in one type."""

    master: Tensor  # (n,) float32, a view of `flat`
    grad: Tensor  # (n,) of the type it computes in
    copy: Tensor | None  # (n,) `master` in that type; None where that is float32


class Norm(NamedTuple):
    """What layer normalisation leaves for the backward pass."""

    mean: Tensor  # (heads, b, 1)
    scale: Tensor  # (heads, b, 1) 1 / standard deviation


class Pass(NamedTuple):
    """One evaluation: written by `forward`, read by the backward pass, overwritten by the next of its size."""

    inputs: list[Tensor]  # of each layer, (heads, b, in)
    products: list[Tensor]  # of each layer with its bias, (heads, b, out); the last is `output`
    norms: list[Norm]  # of each hidden layer; empty without layer normalisation
    slopes: list[Tensor]  # the loss's gradient by each layer's product, (heads, b, out); the caller has the last
    last_slope: Tensor  # (heads, b, in) float32: what the output layer hands down

    @property
    def output(self) -> Tensor:
        """(heads, b, out) float32."""
        return self.products[-1]


class FlatMLP:
    """`heads` ReLU networks with layer widths `sizes` (input first), initialised like torch.nn.Linear.

    `flat` (P,) float32 owns the numbers. `parts` are the hidden layers and the output layer with their
    gradients: what an optimiser steps through. After changing `flat` in another way call `refresh`.
    `normalise` puts a layer normalisation (Ba et al., 2016; no gains) before every ReLU.
    """

    def __init__(
        self,
        sizes: Sequence[int],
        heads: int,
        generator: torch.Generator,
        device: torch.device,
        dtype: torch.dtype,
        normalise: bool = False,
    ) -> None:
        self.sizes, self.heads, self.normalise = tuple(sizes), heads, normalise
        counts = [heads * (i + 1) * o for i, o in zip(self.sizes[:-1], self.sizes[1:], strict=True)]
        self.flat = torch.zeros(sum(counts), device=device)
        hidden, last = self.flat.split([sum(counts[:-1]), counts[-1]])
        copy = None if dtype == torch.float32 else hidden.to(dtype)
        self.parts = (
            Part(hidden, torch.zeros_like(hidden, dtype=dtype), copy),
            Part(last, torch.zeros_like(last), None),
        )
        self.master = self._layers(hidden, last)
        self.layers = self._layers(hidden if copy is None else copy, last)
        self.gradients = self._layers(*(part.grad for part in self.parts))
        self._passes: dict[tuple[int, int], Pass] = {}  # by heads and batch size
        self.reset(generator)

    def reset(self, generator: torch.Generator) -> None:
        """Draw all parameters afresh."""
        for layer in self.master:
            bound = layer.weight.shape[1] ** -0.5
            for tensor in layer:
                drawn = torch.rand(tensor.shape, generator=generator)  # on the CPU: the same for any device
                tensor.copy_((2.0 * drawn - 1.0) * bound)
        self.refresh()

    def refresh(self) -> None:
        """Bring the cast copy up to date with `flat`."""
        for part in self.parts:
            if part.copy is not None:
                part.copy.copy_(part.master)

    def gradient_norm(self) -> Tensor:
        """The 2-norm of the whole gradient, 0-d."""
        return torch.stack([part.grad.float().norm() for part in self.parts]).norm()

    def _layers(self, hidden: Tensor, last: Tensor) -> list[Layer]:
        """The layers as views of two vectors that hold them one after the other."""
        views = []
        at = 0
        for number, (i, o) in enumerate(zip(self.sizes[:-1], self.sizes[1:], strict=True)):
            flat, at = (last, 0) if number == len(self.sizes) - 2 else (hidden, at)
            middle, end = at + self.heads * i * o, at + self.heads * (i + 1) * o
            views.append(Layer(flat[at:middle].view(self.heads, i, o), flat[middle:end].view(self.heads, 1, o)))
            at = end
        return views

    def forward(self, *columns: Tensor, heads: int | None = None) -> Pass:
        """Evaluate the first `heads` networks (all by default) on inputs (b, in), given in one piece or side by side."""
        h, b = self.heads if heads is None else heads, len(columns[0])
        if (h, b) not in self._passes:
            self._passes[h, b] = self._room(h, b)
        done = self._passes[h, b]
        # One copy a head: a matrix product would copy an expanded view, and again in the backward pass.
        at = 0
        for x in columns:
            done.inputs[0][:, :, at : at + x.shape[1]] = x
            at += x.shape[1]
        done.norms.clear()
        for i, layer in enumerate(self.layers):
            y = torch.baddbmm(layer.bias[:h], done.inputs[i], layer.weight[:h], out=done.products[i])
            if i + 1 < len(self.layers):
                if self.normalise:
                    y, mean, scale = torch.native_layer_norm(y, y.shape[-1:], None, None, _NORM_EPSILON)
                    done.norms.append(Norm(mean, scale))
                y.relu_()
                if y is not done.inputs[i + 1]:
                    done.inputs[i + 1].copy_(y)
        return done

    def _room(self, h: int, b: int) -> Pass:
        def empty(width: int, like: Tensor) -> Tensor:
            return torch.empty(h, b, width, dtype=like.dtype, device=like.device)

        inputs = [empty(layer.weight.shape[1], layer.weight) for layer in self.layers]
        products = [empty(layer.weight.shape[2], layer.weight) for layer in self.layers]
        if not self.normalise:  # ReLU in place, where the next layer computes in the same type
            products = [
                x if x.dtype == y.dtype else y for x, y in zip(inputs[1:], products[:-1], strict=True)
            ] + products[-1:]
        slopes = [empty(layer.weight.shape[2], layer.weight) for layer in self.layers[:-1]]
        return Pass(inputs, products, [], slopes, torch.empty_like(inputs[-1]))

    def backward(self, done: Pass, gradient: Tensor) -> None:
        """Fill the gradients of a loss whose gradient by the output is `gradient` (heads, b, out) float32."""
        for i, g in self._descend(done, gradient):
            torch.bmm(done.inputs[i].transpose(1, 2), g, out=self.gradients[i].weight)
            torch.sum(g, 1, keepdim=True, out=self.gradients[i].bias)

    def input_gradient(self, done: Pass, gradient: Tensor, columns: int) -> Tensor:
        """(b, columns) float32: the loss's gradient by the last `columns` inputs; leaves `gradients` alone."""
        *_, (_, g) = self._descend(done, gradient)
        weight = self.layers[0].weight[: len(g), -columns:]
        return torch.bmm(g, weight.transpose(1, 2)).float().sum(0)

    def _descend(self, done: Pass, gradient: Tensor) -> Iterator[tuple[int, Tensor]]:
        """From the last layer to the first: its number, and the loss's gradient by its matrix product."""
        g = gradient
        for i in reversed(range(len(self.layers))):
            yield i, g
            if i:
                weight, to = self.layers[i].weight[: len(g)], done.slopes[i - 1]
                room = done.last_slope if i == len(self.layers) - 1 else to
                g = torch.bmm(g, weight.transpose(1, 2), out=room)
                # Where ReLU gave 0, the next layer's input is 0 and nothing flows back.
                torch.ops.aten.threshold_backward.grad_input(g, done.inputs[i], 0, grad_input=g)
                g = to.copy_(g) if room is not to else g
                if self.normalise:
                    before, norm = done.products[i - 1], done.norms[i - 1]
                    g, _, _ = torch.ops.aten.native_layer_norm_backward(
                        g, before, before.shape[-1:], norm.mean, norm.scale, None, None, [True, False, False]
                    )
