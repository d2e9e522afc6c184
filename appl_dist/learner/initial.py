"""Start learning from an earlier run or policy instead of from random weights (`learner.init`)."""

from __future__ import annotations

from pathlib import Path

import torch
from torch import Tensor

from appl_dist.errors import UserError
from appl_dist.learner import checkpoint
from appl_dist.learner.checkpoint import Checkpoints
from appl_dist.learner.td3 import TD3
from appl_dist.policy_file import PolicyFile
from appl_dist.spec import ParameterSpace

LEARNED = ("actor.", "critic.", "actor_target.", "critic_target.", "actor_optimiser.", "critic_optimiser.")


def initialise(td3: TD3, source: str, space: ParameterSpace) -> str:
    """Take the networks of `source` over; says what was taken.

    source: a run's folder (actor and critics with targets and optimisers from its newest checkpoint) or a policy file
    (the actor and its target; the critics stay random). The counts of updates and the random streams stay those of the
    new run. UserError: nothing to start from, or of another space or other layers.
    """
    path = Path(source)
    if path.is_dir():
        return _from_run(td3, path)
    policy = PolicyFile.load(path)
    if policy.space != space:
        raise UserError(f"learner.init: {path} is for space {policy.space.name!r}; this run has {space.name!r}")
    if not policy.weights:
        raise UserError(f"learner.init: {path} is a fixed set of parameters; give the policy of a trained network")
    arrays = zip(policy.weights, policy.biases, strict=True)
    tensors = {
        f"{net}.mlp.layers.{i}.{name}": torch.from_numpy(array)
        for i, pair in enumerate(arrays)
        for name, array in zip(("weight", "bias"), pair, strict=True)
        for net in ("actor", "actor_target")
    }
    _copy(td3, tensors, path)
    return f"the policy in {path}; critics start anew"


def _from_run(td3: TD3, folder: Path) -> str:
    newest = Checkpoints.newest_in(folder / "checkpoints")
    if newest is None:
        raise UserError(f"learner.init: {folder} holds no checkpoint; give the folder of a run that has trained")
    found = checkpoint.load(newest).tensors
    _copy(td3, {name: tensor for name, tensor in found.items() if name.startswith(LEARNED)}, newest)
    return f"actor, critics and optimisers of {newest}"


@torch.no_grad()
def _copy(td3: TD3, tensors: dict[str, Tensor], source: Path) -> None:
    """Copy into the live tensors of the same names; UserError names the first that does not fit."""
    own, _ = td3.state()
    wanted = {name for name in own if name.startswith(tuple({n.partition(".")[0] + "." for n in tensors}))}
    for name in sorted(wanted | tensors.keys()):
        shapes = [tuple(t[name].shape) if name in t else None for t in (tensors, own)]
        if shapes[0] != shapes[1]:
            raise UserError(
                f"learner.init: {source}: {name} has shape {shapes[0]} there, this run asks for {shapes[1]}; "
                "set learner.td3.hidden and layer_norm as they were"
            )
    for name, tensor in tensors.items():
        own[name].copy_(tensor)
