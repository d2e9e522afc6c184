"""Multilayer perceptrons for TD3: one flat float32 vector each, and twins evaluated as one.

All parameters of a network are views of one flat vector, so Adam, Polyak averaging, casting, norms and
checkpoints are single operations on it. `heads` networks of one shape (the twin Q-functions) run as batched
matrix products. With bfloat16 the hidden layers compute from a cast copy; the output layer, whose rounding
would show in Q-values and actions, and everything that accumulates (parameters, gradients into Adam,
targets) stay float32.
"""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor

Layers = list[tuple[Tensor, Tensor]]  # weight (heads, in, out), bias (heads, 1, out)


class FlatMLP:
    """`heads` ReLU networks with layer widths `sizes` (input first), initialised like torch.nn.Linear.

    `flat` (P,) float32 owns the numbers. After changing it call `refresh`.
    """

    def __init__(
        self,
        sizes: Sequence[int],
        heads: int,
        generator: torch.Generator,
        device: torch.device,
        dtype: torch.dtype,
    ) -> None:
        self.sizes, self.heads = tuple(sizes), heads
        pairs = list(zip(self.sizes[:-1], self.sizes[1:], strict=True))
        self.flat = torch.zeros(sum(heads * (i + 1) * o for i, o in pairs), device=device)
        self.grad = torch.zeros_like(self.flat)  # filled by `store_gradients`, read by the optimiser
        self.flat.grad = self.grad
        self.master = self._views(self.flat)  # every layer, float32, no autograd
        for weight, bias in self.master:
            bound = weight.shape[1] ** -0.5
            for tensor in (weight, bias):
                drawn = torch.rand(tensor.shape, generator=generator)  # CPU generator: same on any device
                tensor.copy_((2.0 * drawn - 1.0) * bound)
        last = heads * (pairs[-1][0] + 1) * pairs[-1][1]
        self._half = None if dtype == torch.float32 else self.flat[:-last].to(dtype)
        hidden = self.master[:-1] if self._half is None else self._views(self._half)
        # Leaves share memory with the flat vectors, so an optimiser step needs no copy back.
        self.layers: Layers = [
            (w.detach().requires_grad_(), b.detach().requires_grad_()) for w, b in (*hidden, self.master[-1])
        ]
        self._grad_views = [t for layer in self._views(self.grad) for t in layer]

    def _views(self, flat: Tensor) -> Layers:
        """Layer views of `flat`, in order, as many as it holds."""
        views: Layers = []
        at = 0
        for i, o in zip(self.sizes[:-1], self.sizes[1:], strict=True):
            if at == len(flat):
                break
            middle, end = at + self.heads * i * o, at + self.heads * (i + 1) * o
            views.append((flat[at:middle].view(self.heads, i, o), flat[middle:end].view(self.heads, 1, o)))
            at = end
        return views

    @property
    def leaves(self) -> list[Tensor]:
        """What to differentiate by."""
        return [t for layer in self.layers for t in layer]

    def refresh(self) -> None:
        """Bring the cast copy up to date with `flat`."""
        if self._half is not None:
            self._half.copy_(self.flat[: len(self._half)])

    def store_gradients(self, gradients: Sequence[Tensor]) -> None:
        """Put the gradients of `leaves` where the optimiser reads them, as float32."""
        for view, gradient in zip(self._grad_views, gradients, strict=True):
            view.copy_(gradient)

    def __call__(self, x: Tensor, heads: int | None = None, frozen: bool = False) -> Tensor:
        """(h, b, out) float32 for inputs x (b, in), of the first `heads` networks (all by default).

        `frozen` keeps gradients flowing to x but not to the parameters.
        """
        h = self.heads if heads is None else heads
        layers = [(w[:h], b[:h]) for w, b in self.layers] if h != self.heads else self.layers
        if frozen:
            layers = [(w.detach(), b.detach()) for w, b in layers]
        y = x.to(layers[0][0].dtype).expand(h, *x.shape)
        for weight, bias in layers[:-1]:
            y = torch.baddbmm(bias, y, weight).relu_()
        weight, bias = layers[-1]
        return torch.baddbmm(bias, y.float(), weight)
