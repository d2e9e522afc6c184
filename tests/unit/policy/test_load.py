from __future__ import annotations

import subprocess
import sys
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from appl_dist.errors import UserError
from appl_dist.planner.dwa import DWA, DWA_WIDE
from appl_dist.policy.fixed import PUBLISHED_SETS, StaticPolicy
from appl_dist.policy.load import load_policy, policy_from_file
from appl_dist.policy.network import MLPPolicy
from appl_dist.policy_file import PolicyFile
from tests.paper_sizes import LAYOUT, OBSERVATION_SIZE


def file(hidden: tuple[int, ...] = (20, 10)) -> PolicyFile:
    rng = np.random.default_rng(0)
    sizes = (OBSERVATION_SIZE, *hidden, 8)
    pairs = list(pairwise(sizes))
    return PolicyFile(
        tuple((rng.normal(size=(o, i)) / np.sqrt(i)).astype(np.float32) for i, o in pairs),
        tuple(rng.normal(size=o).astype(np.float32) for _, o in pairs),
        space=DWA,
        observation=LAYOUT,
    )


def observations(n: int) -> np.ndarray:
    return np.random.default_rng(1).uniform(-1, 1, (n, OBSERVATION_SIZE)).astype(np.float32)


@pytest.mark.parametrize("hidden", [(), (20, 10), (512, 512, 512)])
def test_the_forward_pass_equals_its_definition(hidden: tuple[int, ...]) -> None:
    made = file(hidden)
    policy = MLPPolicy(made)
    for obs in observations(5):
        x = obs.astype(np.float64)
        for i, (w, b) in enumerate(zip(made.weights, made.biases, strict=True)):
            x = w @ x + b
            x = np.maximum(x, 0) if i < len(hidden) else np.tanh(x)
        np.testing.assert_allclose(policy.act(obs), x, atol=1e-5)
        assert policy.act(obs).dtype == np.float32


def test_an_action_is_not_overwritten_by_the_next() -> None:
    policy = MLPPolicy(file())
    first, second = observations(2)
    action = policy.act(first)
    kept = action.copy()
    policy.act(second)
    np.testing.assert_array_equal(action, kept)


def test_an_observation_of_another_layout_is_refused() -> None:
    with pytest.raises(ValueError, match=r"observation: got float32\(5,\); expected float32\(729,\)"):
        MLPPolicy(file()).act(np.zeros(5, np.float32))
    with pytest.raises(ValueError, match="got float64"):
        MLPPolicy(file()).act(np.zeros(OBSERVATION_SIZE))


@pytest.mark.parametrize("name", [*PUBLISHED_SETS, "default"])
def test_published_sets_come_out_of_the_action_unchanged(name: str) -> None:
    policy = load_policy(name, DWA_WIDE, LAYOUT)
    wanted = PUBLISHED_SETS.get(name, tuple(DWA.defaults))
    np.testing.assert_allclose(DWA_WIDE.to_values(policy.act(observations(1)[0])), wanted, atol=1e-5)


def test_a_set_outside_the_bounds_is_refused_never_clipped() -> None:
    with pytest.raises(UserError, match=r"appld:curve: values: occdist_scale = 0\.04; dwa allows .*dwa_wide"):
        load_policy("appld:curve", DWA, LAYOUT)
    load_policy("appli:A1", DWA, LAYOUT)


def test_a_set_changes_what_it_names_and_keeps_the_defaults() -> None:
    policy = load_policy("set:max_vel_x=2.0, vx_samples=12", DWA, LAYOUT)
    assert isinstance(policy, StaticPolicy)
    assert policy.values.tolist() == [2.0, 1.57, 12, 20, 0.1, 0.75, 1.0, 0.30]


@pytest.mark.parametrize(
    ("spec", "message"),
    [
        ("set:max_vel=2", "'max_vel=2' is not NAME=VALUE with NAME one of max_vel_x"),
        ("set:", "'' is not NAME=VALUE"),
        ("set:max_vel_x=fast", "max_vel_x = 'fast' is not a number"),
        ("set:max_vel_x=1,max_vel_x=2", "max_vel_x is given twice"),
        ("set:max_vel_x=3", r"max_vel_x = 3; dwa allows 0\.2\.\.2"),
        ("set:max_vel_x=nan", "max_vel_x = nan; dwa allows"),
        ("set:vx_samples=4.5", "vx_samples = 4.5; it must be a whole number"),
        ("appli:Z9", "not a published set; allowed appli:A1, appli:A2"),
        ("nowhere", "no such file, nor a name. Allowed: appli:A1"),
        ("default:now", "default takes nothing after its name"),
    ],
)
def test_a_spec_that_means_nothing_is_explained(spec: str, message: str) -> None:
    with pytest.raises(UserError, match=message):
        load_policy(spec, DWA, LAYOUT)


def test_files_load_as_what_they_hold_and_only_for_their_space(tmp_path: Path) -> None:
    path = tmp_path / "policy.safetensors"
    file().save(path)
    assert isinstance(load_policy(str(path), DWA, LAYOUT), MLPPolicy)
    with pytest.raises(UserError, match="made for the parameter space 'dwa', this run has 'dwa_wide'"):
        load_policy(str(path), DWA_WIDE, LAYOUT)
    fixed = policy_from_file(PolicyFile(values=DWA.defaults, space=DWA), DWA, "x", LAYOUT)
    np.testing.assert_array_equal(
        fixed.act(observations(1)[0]), load_policy("default", DWA, LAYOUT).act(observations(1)[0])
    )


def test_policies_import_no_torch() -> None:
    code = "import sys, appl_dist.policy.load; sys.exit('torch' in sys.modules or 'scipy' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0
