"""The policy network: observation in, action in [-1, 1] out, the same bits on every machine.

An actor imports no torch: the papers' 512-512-512 network is four matrix-vector products in C (`csrc/network.h`), about
0.1 ms on one core. BLAS is no choice here: it picks its kernels, and with them the order of sums, by processor.
"""

from __future__ import annotations

import numpy as np

from appl_dist._native import Network
from appl_dist.policy_file import PolicyFile
from appl_dist.spec import FloatArray


class MLPPolicy:
    """The deterministic policy of a PolicyFile: ReLU layers, tanh output.

    Not thread-safe: activations are preallocated.
    """

    def __init__(self, file: PolicyFile) -> None:
        if not file.weights:
            raise ValueError("policy file: holds fixed values, not an MLP")
        assert file.observation is not None
        self.file, self._size = file, file.observation.size
        self._network = Network()
        for w, b in zip(file.weights, file.biases, strict=True):
            self._network.add(np.ascontiguousarray(w), np.ascontiguousarray(b))

    def act(self, observation: FloatArray) -> FloatArray:
        """(n,) float32 for an observation (size,) float32; ValueError for another shape or type."""
        size = self._size
        if observation.shape != (size,) or observation.dtype != np.float32:
            got = f"{observation.dtype}{observation.shape}"
            raise ValueError(f"observation: got {got}; expected float32({size},)")
        action = np.empty(len(self.file.space), np.float32)
        self._network.act(np.ascontiguousarray(observation), action)
        return action
