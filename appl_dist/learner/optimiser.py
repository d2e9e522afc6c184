"""What a TD3 step does to whole parameter vectors: Adam (Kingma and Ba, ICLR 2015, Alg. 1) and Polyak averaging.

Comes in: a `FlatMLP` with its gradient filled. Goes out: the same, one step on, its cast copy up to date. Both are
bound by memory, so on the CPU one pass of C reads and writes each number once (csrc/adam.h), less than half the time
of a cast, torch's fused Adam and another cast. Other devices run the same formulas as torch operations.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import torch
from torch import Tensor

from appl_dist import _native
from appl_dist.learner.networks import FlatMLP
from appl_dist.learner.workers import Workers

BETA1, BETA2, EPSILON = 0.9, 0.999, 1e-8


class Adam:
    """Adam with its usual constants on all parameters of `net`. `first`, `second` (P,) are the moments."""

    def __init__(self, net: FlatMLP, rate: float, workers: Workers) -> None:
        self.steps, self.rate = 0, rate
        self.first, self.second = torch.zeros_like(net.flat), torch.zeros_like(net.flat)
        self._workers = workers
        self._step: Callable[..., None] = _adam_native if net.flat.device.type == "cpu" else _adam_torch
        sizes = [len(part.master) for part in net.parts]
        self._pieces = []
        for part, m, v in zip(net.parts, self.first.split(sizes), self.second.split(sizes), strict=True):
            self._pieces += _cut(workers.threads, part.master, part.grad, m, v, part.copy)

    def step(self) -> None:
        """Move the parameters down their gradient and refresh the cast copy."""
        self.steps += 1
        self._workers.each(lambda piece: self._step(*piece, self.steps, self.rate), self._pieces)


def average(target: FlatMLP, net: FlatMLP, tau: float, workers: Workers) -> None:
    """target <- tau net + (1 - tau) target (TD3 paper, Alg. 1), its cast copy refreshed."""
    step: Callable[..., None] = _average_native if net.flat.device.type == "cpu" else _average_torch
    pieces = []
    for to, part in zip(target.parts, net.parts, strict=True):
        pieces += _cut(workers.threads, to.master, part.master, to.copy)
    workers.each(lambda piece: step(*piece, tau), pieces)


def _cut(count: int, *vectors: Tensor | None) -> list[tuple[Any, ...]]:
    """The vectors in `count` pieces each, piece by piece; None gives Nones."""
    cuts = [[None] * count if vector is None else vector.tensor_split(count) for vector in vectors]
    return list(zip(*cuts, strict=True))


def _bits(x: Tensor) -> Tensor:
    return x.view(torch.uint16) if x.dtype == torch.bfloat16 else x


def _adam_native(p: Tensor, g: Tensor, m: Tensor, v: Tensor, copy: Tensor | None, step: int, rate: float) -> None:
    _native.adam(
        p, _bits(g), m, v, None if copy is None else _bits(copy),
        step=step, rate=rate, beta1=BETA1, beta2=BETA2, epsilon=EPSILON,
    )  # fmt: skip


def _adam_torch(p: Tensor, g: Tensor, m: Tensor, v: Tensor, copy: Tensor | None, step: int, rate: float) -> None:
    g = g.float()
    m.lerp_(g, 1.0 - BETA1)
    v.mul_(BETA2).addcmul_(g, g, value=1.0 - BETA2)
    root = v.sqrt().div_((1.0 - BETA2**step) ** 0.5).add_(EPSILON)
    p.addcdiv_(m, root, value=-rate / (1.0 - BETA1**step))
    if copy is not None:
        copy.copy_(p)


def _average_native(target: Tensor, p: Tensor, copy: Tensor | None, tau: float) -> None:
    _native.polyak(target, p, None if copy is None else _bits(copy), tau=tau)


def _average_torch(target: Tensor, p: Tensor, copy: Tensor | None, tau: float) -> None:
    target.lerp_(p, tau)
    if copy is not None:
        copy.copy_(target)
