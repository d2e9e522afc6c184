"""Policies that actors and evaluation run: observation in, action in [-1, 1] out. numpy only.

An actor carries no torch: the paper's 729-512-512-512-8 network is four matrix-vector products, about
0.1 ms on one core. Fixed parameter sets are policies too, so every comparison runs the same loop.
"""

from __future__ import annotations

from pathlib import Path
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from appl_dist.errors import UserError
from appl_dist.policy_file import PolicyFile
from appl_dist.spec import OBSERVATION_SIZE, FloatArray, ParameterSpace

# Parameter sets published for APPLI (ICRA 2021, Tab. I) and APPLD (RA-L 2020, Tab. I), in spec.DWA order:
# max_vel_x, max_vel_theta, vx_samples, vtheta_samples, occdist, pdist, gdist scales, inflation_radius.
PUBLISHED_SETS: dict[str, tuple[float, ...]] = {
    "appli:A1": (0.26, 2.00, 13, 44, 0.57, 0.76, 0.94, 0.02),
    "appli:A2": (0.22, 0.87, 13, 31, 0.30, 0.36, 0.71, 0.30),
    "appli:B1": (1.91, 1.70, 10, 47, 0.08, 0.71, 0.35, 0.23),
    "appli:B2": (0.72, 0.73, 19, 59, 0.62, 1.00, 0.32, 0.24),
    "appli:D1": (0.37, 1.33, 9, 6, 0.95, 0.83, 0.93, 0.01),
    "appli:D2": (0.31, 1.05, 17, 20, 0.45, 0.61, 0.22, 0.23),
    "appld:curve": (0.80, 0.73, 6, 42, 0.04, 0.98, 0.94, 0.19),
    "appld:obstacle-field": (0.71, 0.91, 16, 53, 0.55, 0.54, 0.91, 0.39),
    "appld:corridor": (0.25, 1.34, 8, 59, 0.43, 0.65, 0.98, 0.40),
    "appld:open": (1.59, 0.89, 18, 18, 0.40, 0.46, 0.27, 0.42),
    "appld:no-context": (1.55, 0.98, 10, 3, 0.01, 0.87, 0.99, 0.46),
}


class Policy(Protocol):
    """What chooses the planner's parameters once per decision period."""

    def act(self, observation: FloatArray) -> FloatArray:
        """(n,) float32 action in [-1, 1] for an observation (OBSERVATION_SIZE,) float32; a fresh array."""
        ...


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
        if observation.shape != (OBSERVATION_SIZE,) or observation.dtype != np.float32:
            got = f"{observation.dtype}{observation.shape}"
            raise ValueError(f"observation: got {got}; expected float32({OBSERVATION_SIZE},)")
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


class StaticPolicy:
    """One fixed parameter set. `values` (n,) must lie in `space`; UserError says which does not."""

    def __init__(self, values: NDArray[np.float64], space: ParameterSpace, label: str = "fixed set") -> None:
        try:
            self.file = PolicyFile(values=np.asarray(values, np.float64), space=space)
        except ValueError as e:
            hint = "; use the space dwa_wide" if space.name == "dwa" and label in PUBLISHED_SETS else ""
            raise UserError(f"{label}: {e}{hint}") from None
        self._action = space.to_action(np.asarray(values))

    @property
    def values(self) -> NDArray[np.float64]:
        """(n,) the parameter values, in the space's order."""
        assert self.file.values is not None
        return self.file.values

    def act(self, observation: FloatArray) -> FloatArray:
        return self._action.copy()


def default_policy(space: ParameterSpace) -> StaticPolicy:
    """The expert's hand-tuned parameters, the baseline of every table in the papers."""
    return StaticPolicy(space.defaults, space, "default")


def load_policy(spec: str, space: ParameterSpace) -> MLPPolicy | StaticPolicy:
    """The policy a user names: `default`, a published set such as `appli:A1` or `appld:curve`,
    `set:max_vel_x=2.0,vx_samples=12` (the rest default), or the path of a policy file.
    """
    if spec == "default":
        return default_policy(space)
    if spec in PUBLISHED_SETS:
        values = PUBLISHED_SETS[spec]
        if len(space) != len(values) or not space.name.startswith("dwa"):
            raise UserError(f"policy {spec!r}: a set for the DWA planner; the space is {space.name!r}")
        return StaticPolicy(np.array(values), space, spec)
    if spec.startswith("set:"):
        return StaticPolicy(_parse_set(spec, space), space, f"policy {spec!r}")
    if not Path(spec).is_file():
        named = ", ".join(PUBLISHED_SETS)
        raise UserError(
            f"policy {spec!r}: no such file, nor a name. "
            f"Allowed: default, {named}, set:NAME=VALUE,..., or a policy file"
        )
    return policy_from_file(PolicyFile.load(spec), space, spec)


def policy_from_file(file: PolicyFile, space: ParameterSpace, source: str) -> MLPPolicy | StaticPolicy:
    """The runnable policy of `file`, refused if it was made for other parameters or bounds than `space`."""
    if file.space != space:
        raise UserError(
            f"{source}: made for the parameter space {file.space.name!r}, this run has {space.name!r}; "
            f"its actions would mean other values. Choose the space {file.space.name!r} for the run"
        )
    if file.values is not None:
        return StaticPolicy(file.values, space, source)
    return MLPPolicy(file)


def _parse_set(spec: str, space: ParameterSpace) -> NDArray[np.float64]:
    values = space.defaults
    seen = set()
    for item in spec.removeprefix("set:").split(","):
        name, equals, text = (part.strip() for part in item.partition("="))
        if not equals or name not in space.names:
            allowed = ", ".join(space.names)
            raise UserError(f"policy {spec!r}: {item!r} is not NAME=VALUE with NAME one of {allowed}")
        if name in seen:
            raise UserError(f"policy {spec!r}: {name} is given twice")
        try:
            values[space.names.index(name)] = float(text)
        except ValueError:
            raise UserError(f"policy {spec!r}: {name} = {text!r} is not a number") from None
        seen.add(name)
    return values
