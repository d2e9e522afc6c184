"""The policy that a user names, or that a file holds. POLICIES is where a user adds a kind of his own."""

from __future__ import annotations

import functools
from collections.abc import Callable
from pathlib import Path
from typing import Protocol

from appl_dist.errors import UserError
from appl_dist.policy.fixed import PUBLISHED_SETS, StaticPolicy, default_policy, given_set, published_set
from appl_dist.policy.network import MLPPolicy
from appl_dist.policy_file import PolicyFile
from appl_dist.registry import Registry
from appl_dist.spec import FloatArray, ObservationLayout, ParameterSpace


class Policy(Protocol):
    """What chooses the planner's parameters once per decision period."""

    def act(self, observation: FloatArray) -> FloatArray:
        """(n,) float32 action in [-1, 1] for an observation (size,) float32; a fresh array."""
        ...


Factory = Callable[[str, ParameterSpace], Policy]


def _default(text: str, space: ParameterSpace) -> Policy:
    if text:
        raise UserError(f"policy 'default:{text}': default takes nothing after its name")
    return default_policy(space)


def _published(paper: str, text: str, space: ParameterSpace) -> Policy:
    name = f"{paper}:{text}"
    if name not in PUBLISHED_SETS:
        raise UserError(f"policy {name!r}: not a published set; allowed {', '.join(PUBLISHED_SETS)}")
    return published_set(name, space)


# Kind of policy to its factory, which gets the text after `kind:` ("" if there is none) and the run's space.
POLICIES: Registry[Factory] = Registry(
    "policy",
    {
        "default": _default,
        "set": given_set,
        "appli": functools.partial(_published, "appli"),
        "appld": functools.partial(_published, "appld"),
    },
)


def load_policy(spec: str, space: ParameterSpace, observation: ObservationLayout) -> Policy:
    """The policy a user names: `default`, a published set such as `appli:A1` or `appld:curve`,
    `set:max_vel_x=2.0,vx_samples=12` (the rest default), a registered `KIND` or `KIND:TEXT`, or a policy file's path.
    """
    kind, _, text = spec.partition(":")
    if kind in POLICIES:
        return POLICIES.get(kind)(text, space)
    if Path(spec).is_file():
        return policy_from_file(PolicyFile.load(spec), space, spec, observation)
    raise UserError(
        f"policy {spec!r}: no such file, nor a name. Allowed: "
        f"{', '.join([*PUBLISHED_SETS, *POLICIES.names()])}, set:NAME=VALUE,..., or a policy file"
    )


def policy_from_file(
    file: PolicyFile, space: ParameterSpace, source: str, observation: ObservationLayout
) -> MLPPolicy | StaticPolicy:
    """The runnable policy of `file`, refused if it was made for other parameters, bounds or observations."""
    if file.space.name == space.name and file.space != space:
        raise UserError(
            f"{source}: made for a parameter space {space.name!r} with other names or bounds than that of this run; "
            "its actions would mean other values"
        )
    if file.space != space:
        raise UserError(
            f"{source}: made for the parameter space {file.space.name!r}, this run has {space.name!r}; "
            f"its actions would mean other values. Choose the space {file.space.name!r} for the run"
        )
    if file.values is not None:
        return StaticPolicy(file.values, space, source)
    if file.observation != observation:
        raise UserError(f"{source}: made for {file.observation}, this run has {observation}")
    return MLPPolicy(file)
