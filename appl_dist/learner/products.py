"""The matrix products of a layer, forward and backward, prepared once for fixed memory and then only run.

Tensors are (heads, rows, columns). bfloat16 on a CPU with AMX tiles runs in C (csrc/amx.h), one head at a time, where
bias, ReLU, the backward pass's mask and the bias gradient cost little beside the product; everything else are torch
operations on all heads at once.
"""

from __future__ import annotations

from collections.abc import Callable

import torch
from torch import Tensor

from appl_dist import _native

Step = Callable[[], object]


def tiled(dtype: torch.dtype, device: torch.device) -> bool:
    """Whether products of this type run in C here."""
    return dtype == torch.bfloat16 and device.type == "cpu" and _native.has_tiles()


def forward(x: Tensor, rest: Tensor | None, weight: Tensor, bias: Tensor, out: Tensor, relu: bool) -> Step:
    """out (h, b, o) = x (h, b, i) weight (h, i, o) + bias (h, 1, o), then ReLU if asked for.

    rest (h, b, r) is added to the last r columns of x, without being rounded there.
    """
    if tiled(out.dtype, out.device):
        left = None if rest is None else rest[0]
        return _one(_native.Product(x[0], weight[0], out[0], rest=left, bias=bias[0], relu=relu), out)

    def step() -> None:
        offset = bias if rest is None else torch.baddbmm(bias, rest, weight[:, -rest.shape[2] :])
        torch.baddbmm(offset, x, weight, out=out)
        if relu:
            out.relu_()

    return step


def by_input(slope: Tensor, weight: Tensor, open_: Tensor, out: Tensor) -> Step:
    """out (h, b, i) = slope (h, b, o) weight^T, but 0 where open_ (h, b, i), which ReLU made, is 0: nothing flows back.

    Where `out` is narrower than the factors they are multiplied before they are rounded.
    """
    if slope.dtype == out.dtype and tiled(out.dtype, out.device):
        return _one(_native.Product(slope[0], weight[0], out[0], transpose_b=True, open=open_[0]), out)
    turned = weight.transpose(1, 2)
    product = out if slope.dtype == out.dtype else torch.empty_like(out, dtype=slope.dtype)

    def step() -> None:
        torch.bmm(slope, turned, out=product)
        if product is not out:
            out.copy_(product)
        torch.ops.aten.threshold_backward.grad_input(out, open_, 0, grad_input=out)

    return step


def by_parameters(x: Tensor, slope: Tensor, weight: Tensor, bias: Tensor | None) -> Step:
    """weight (h, i, o) = x^T slope and bias (h, 1, o) = the sums of slope (h, b, o): a loss's gradients."""
    if tiled(weight.dtype, weight.device):
        sums = None if bias is None else bias[0]
        return _one(_native.Product(x[0], slope[0], weight[0], transpose_a=True, sums=sums), weight)
    turned = x.transpose(1, 2)

    def step() -> None:
        torch.bmm(turned, slope, out=weight)
        if bias is not None:
            torch.sum(slope, 1, keepdim=True, out=bias)

    return step


def _one(product: Step, out: Tensor) -> Step:
    if len(out) != 1:
        raise ValueError(f"products in C: got {len(out)} heads; one at a time")
    return product
