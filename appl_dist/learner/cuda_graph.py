"""A training step replayed as one CUDA graph: hundreds of small kernels for one launch."""

from __future__ import annotations

from collections.abc import Callable

import torch
from torch import Tensor

WARM_UP = 3  # calls before the capture, in which libraries allocate what a graph must find in place


class GraphedStep:
    """`step` of tensors with fixed shapes, with the same effect and results.

    The first calls run it as it is, on a side stream; then it is captured and replayed. Results lie in the graph's own
    memory: they hold until the next call.
    """

    def __init__(self, step: Callable[..., dict[str, Tensor]]) -> None:
        self._step = step
        self._calls = 0
        self._graph: torch.cuda.CUDAGraph | None = None
        self._inputs: tuple[Tensor, ...] = ()
        self._results: dict[str, Tensor] = {}

    def __call__(self, *inputs: Tensor) -> dict[str, Tensor]:
        if self._calls < WARM_UP:
            self._calls += 1
            return self._on_side_stream(*inputs)
        if self._graph is None:
            self._inputs = tuple(tensor.clone() for tensor in inputs)
            self._graph = torch.cuda.CUDAGraph()
            with torch.cuda.graph(self._graph):
                self._results = self._step(*self._inputs)
        for own, tensor in zip(self._inputs, inputs, strict=True):
            own.copy_(tensor, non_blocking=True)
        self._graph.replay()
        return dict(self._results)

    def _on_side_stream(self, *inputs: Tensor) -> dict[str, Tensor]:
        side = torch.cuda.Stream()
        side.wait_stream(torch.cuda.current_stream())
        with torch.cuda.stream(side):
            results = self._step(*inputs)
        torch.cuda.current_stream().wait_stream(side)
        return results
