"""Fixed parameter sets as policies, so that every comparison runs the same loop: default, published, given."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from appl_dist.errors import UserError
from appl_dist.policy_file import PolicyFile
from appl_dist.spec import FloatArray, ParameterSpace

# Parameter sets published for APPLI (ICRA 2021, Tab. I) and APPLD (RA-L 2020, Tab. I), in the order of planner/dwa.py:
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


def published_set(name: str, space: ParameterSpace) -> StaticPolicy:
    """A set of PUBLISHED_SETS. UserError: the space is not of the planner dwa or does not hold it."""
    values = PUBLISHED_SETS[name]
    if len(space) != len(values) or space.planner != "dwa":
        raise UserError(f"policy {name!r}: a set for the planner dwa; the space {space.name!r} is of {space.planner!r}")
    return StaticPolicy(np.array(values), space, name)


def given_set(text: str, space: ParameterSpace) -> StaticPolicy:
    """The set that `set:text` names, with `text` as in max_vel_x=2.0,vx_samples=12; the rest is default."""
    spec, values, seen = f"set:{text}", space.defaults, set()
    for item in text.split(","):
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
    return StaticPolicy(values, space, f"policy {spec!r}")
