"""One evaluation of a network and its way back: memory and operations, prepared once for a number of inputs.

The operations lie in pieces that do not depend on each other, for as many threads as there are: by head, and by rows
of the batch if there are fewer heads than threads; the parameters' gradients by head and rows of the weights. Each
number is computed in the same way whatever the pieces, so threads change no bit.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from typing import NamedTuple

import torch
from torch import Tensor

from appl_dist.learner import products
from appl_dist.learner.products import Step
from appl_dist.learner.workers import Workers

_NORM_EPSILON = 1e-5
# bfloat16 rounds a network's inputs to 8 bits, which moves its values more than all the rounding behind (benchmarks/
# td3_precision.py). So the last FINE inputs, in navigation the goal's bearing, the parameters and the action, are read
# in two parts, rounded and what rounding left. Of the scan's beams replay itself holds 8 bits.
FINE = 32

Piece = list[Step]  # in this order


class Layer(NamedTuple):
    weight: Tensor  # (heads, in, out)
    bias: Tensor  # (heads, 1, out)


class Pass:
    """`read` takes the inputs, `ahead` evaluates them; then `output` (heads, b, out) float32 holds the result.

    After `ahead`, `slope` is to be filled with a loss's gradient by the output before `down` or `to_inputs`.
    """

    def __init__(
        self, layers: Sequence[Layer], gradients: Sequence[Layer], b: int, normalise: bool, workers: Workers
    ) -> None:
        self._workers, self._layers, self._gradients = workers, layers, gradients
        self._count, self._heads = len(layers), len(layers[0].weight)

        def room(width: int, like: Layer) -> Tensor:
            return torch.zeros(self._heads, b, width, dtype=like.weight.dtype, device=like.weight.device)

        sizes = [layer.weight.shape[2] for layer in layers]
        width = layers[0].weight.shape[1]
        fine = min(FINE, width) if layers[0].weight.dtype == torch.bfloat16 else 0
        self._inputs, self._rest = (room(w, layers[0])[:1].expand(self._heads, -1, -1) for w in (width, fine))
        self._after = [room(s, layer) for s, layer in zip(sizes, layers, strict=True)]  # behind ReLU
        self._before = [room(s, layer) for s, layer in zip(sizes, layers, strict=True)] if normalise else self._after
        # What each layer reads: the layer's before it, in its own type.
        self._read = [self._inputs] + [
            y if y.dtype == layer.weight.dtype else room(y.shape[2], layer)
            for y, layer in zip(self._after, layers[1:], strict=False)
        ]
        self._slopes = [room(s, layer) for s, layer in zip(sizes, layers, strict=True)]  # by each layer's product
        self.output, self.slope = self._before[-1], self._slopes[-1]
        self._normalise = normalise
        in_pieces = products.tiled(layers[0].weight.dtype, layers[0].weight.device)
        chunks = -(-workers.threads // self._heads) if in_pieces else 1
        heads = [slice(h, h + 1) for h in range(self._heads)] if in_pieces else [slice(None)]
        rows = [slice(b * c // chunks, b * (c + 1) // chunks) for c in range(chunks)]
        self._norms: dict[tuple[int, int, int], tuple[Tensor, Tensor]] = {}
        self._ahead = [self._forward(h, r) for h in heads for r in rows]
        self._down = [self._backward(h, r) for h in heads for r in rows]
        self._last = [self._parameters(h, c, chunks) for h in heads for c in range(chunks)]

    def read(self, columns: Sequence[Tensor]) -> None:
        """Take the inputs (b, in), in pieces side by side."""
        end = self._inputs.shape[2]
        coarse = end - self._rest.shape[2]
        for x in reversed(columns):
            start = end - x.shape[1]
            self._inputs[0, :, start:end] = x
            at = max(start, coarse)
            if at < end:
                self._rest[0, :, at - coarse : end - coarse] = x[:, at - start :] - self._inputs[0, :, at:end]
            end = start

    def ahead(self) -> None:
        self._workers.each(_run, self._ahead)

    def to_inputs(self) -> Tensor:
        """The gradient of the loss by the first layer's product, (heads, b, out)."""
        self._workers.each(_run, self._down)
        return self._slopes[0]

    def down(self) -> None:
        """Fill the parameters' gradients."""
        self._workers.each(_run, self._down)
        self._workers.each(_run, self._last)

    def _forward(self, h: slice, r: slice) -> Piece:
        piece: Piece = []
        for i, layer in enumerate(self._layers):
            hidden = i + 1 < self._count
            before, after = self._before[i][h, r], self._after[i][h, r]
            rest = self._rest[h, r] if i == 0 and self._rest.shape[2] else None
            relu = hidden and not self._normalise
            piece.append(products.forward(self._read[i][h, r], rest, layer.weight[h], layer.bias[h], before, relu))
            if hidden and self._normalise:
                piece.append(partial(self._normalised, (i, h.start or 0, r.start), before, after))
            if hidden and self._read[i + 1] is not self._after[i]:
                piece.append(partial(self._read[i + 1][h, r].copy_, after))
        return piece

    def _backward(self, h: slice, r: slice) -> Piece:
        piece: Piece = []
        for i in range(self._count - 1, 0, -1):
            slope, to, after = self._slopes[i][h, r], self._slopes[i - 1][h, r], self._after[i - 1][h, r]
            piece.append(products.by_input(slope, self._layers[i].weight[h], after, to))
            if self._normalise:
                before = self._before[i - 1][h, r]
                piece.append(partial(self._unnormalised, (i - 1, h.start or 0, r.start), before, to))
        return piece

    def _parameters(self, h: slice, chunk: int, chunks: int) -> Piece:
        piece: Piece = []
        for read, slope, gradient in zip(self._read, self._slopes, self._gradients, strict=True):
            n = read.shape[2]
            part = slice(n * chunk // chunks, n * (chunk + 1) // chunks)
            if part.start < part.stop:
                bias = gradient.bias[h] if part.start == 0 else None
                piece.append(products.by_parameters(read[h, :, part], slope[h], gradient.weight[h, part], bias))
        return piece

    def _normalised(self, key: tuple[int, int, int], before: Tensor, after: Tensor) -> None:
        y, mean, scale = torch.native_layer_norm(before, before.shape[-1:], None, None, _NORM_EPSILON)
        self._norms[key] = mean, scale
        after.copy_(y.relu_())

    def _unnormalised(self, key: tuple[int, int, int], before: Tensor, slope: Tensor) -> None:
        mean, scale = self._norms[key]
        by_input, _, _ = torch.ops.aten.native_layer_norm_backward(
            slope, before, before.shape[-1:], mean, scale, None, None, [True, False, False]
        )
        slope.copy_(by_input)


def _run(piece: Piece) -> None:
    for step in piece:
        step()
