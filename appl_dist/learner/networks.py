"""Multilayer perceptrons for TD3: one flat float32 vector each, and twins evaluated as one.

All parameters of a network are views of one flat vector, so Adam, Polyak averaging, norms and checkpoints are
single operations on it. With bfloat16 the hidden layers compute from a cast copy; the output layer, whose rounding
would show in Q-values and actions, and everything that accumulates (parameters, Adam's moments, targets) stay float32.

The backward pass is written out (a chain of matrix products, tested against autograd): gradients go straight
into the optimiser's vectors, and the actor's loss is differentiated by the action alone, not by 729
observation entries and the critic's weights. Memory and operations of a pass are prepared once (passes.py).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import torch
from torch import Tensor

from appl_dist.learner.passes import Layer, Pass
from appl_dist.learner.workers import Workers


class Part(NamedTuple):
    """A stretch of a network's parameters that computes in one type."""

    master: Tensor  # (n,) float32, a view of `flat`
    grad: Tensor  # (n,) of the type it computes in
    copy: Tensor | None  # (n,) `master` in that type; None where that is float32


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
        workers: Workers | None = None,
    ) -> None:
        self.sizes, self.heads, self.normalise = tuple(sizes), heads, normalise
        self._workers = Workers() if workers is None else workers
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
        """Evaluate the first `heads` networks (all by default) on inputs (b, in), given in one piece or side by side.

        The pass holds until the next one of as many heads and inputs.
        """
        h, b = self.heads if heads is None else heads, len(columns[0])
        if (h, b) not in self._passes:
            layers, gradients = ([Layer(w[:h], c[:h]) for w, c in of] for of in (self.layers, self.gradients))
            self._passes[h, b] = Pass(layers, gradients, b, self.normalise, self._workers)
        done = self._passes[h, b]
        done.read(columns)
        done.ahead()
        return done

    def backward(self, done: Pass, gradient: Tensor) -> None:
        """Fill the gradients of a loss whose gradient by the output is `gradient` (heads, b, out) float32."""
        done.slope.copy_(gradient)
        done.down()

    def input_gradient(self, done: Pass, gradient: Tensor, columns: int) -> Tensor:
        """(b, columns) float32: the loss's gradient by the last `columns` inputs; leaves `gradients` alone."""
        done.slope.copy_(gradient)
        slope = done.to_inputs()
        weight = self.layers[0].weight[: len(slope), -columns:]
        return torch.bmm(slope, weight.transpose(1, 2)).float().sum(0)
