"""The policy network in numpy: observation in, action in [-1, 1] out.

An actor imports no torch: the papers' 512-512-512 network is four matrix-vector products, about 0.1 ms on one core.
"""

from __future__ import annotations

import numpy as np

from appl_dist.policy_file import PolicyFile
from appl_dist.spec import FloatArray


class MLPPolicy:
    """The deterministic policy of a PolicyFile: ReLU layers, tanh output.

    Not thread-safe: activations are preallocated.
    """

    def __init__(self, file: PolicyFile) -> None:
        if not file.weights:
            raise ValueError("policy file: holds fixed values, not an MLP")
        self.file = file
        self._weights = [np.ascontiguousarray(w) for w in file.weights]
        self._activations = [np.empty(len(b), np.float32) for b in file.biases]

    def act(self, observation: FloatArray) -> FloatArray:
        size = self.file.observation.size
        if observation.shape != (size,) or observation.dtype != np.float32:
            got = f"{observation.dtype}{observation.shape}"
            raise ValueError(f"observation: got {got}; expected float32({size},)")
        x = observation
        last = len(self._weights) - 1
        for i, (w, b, out) in enumerate(zip(self._weights, self.file.biases, self._activations, strict=True)):
            np.dot(w, x, out=out)
            out += b
            if i < last:
                np.maximum(out, 0.0, out=out)
            x = out
        action: FloatArray = np.tanh(x)
        return action
