from __future__ import annotations

import json
import struct
from collections.abc import Callable
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from appl_dist.errors import UserError
from appl_dist.planner.dwa import DWA, DWA_WIDE
from appl_dist.policy_file import PolicyFile
from appl_dist.spec import Parameter, ParameterSpace
from tests.paper_sizes import LAYOUT, OBSERVATION_SIZE


def mlp(**change: Any) -> PolicyFile:
    rng = np.random.default_rng(0)
    sizes = (OBSERVATION_SIZE, 6, 8)
    fields: dict[str, Any] = {
        "space": DWA,
        "observation": LAYOUT,
        "weights": tuple(rng.normal(size=(o, i)).astype(np.float32) for i, o in pairwise(sizes)),
        "biases": tuple(rng.normal(size=o).astype(np.float32) for o in sizes[1:]),
    }
    return PolicyFile(**{**fields, "epoch": 2, "version": 7, "transitions": 123, **change})


def with_header(blob: bytes, change: Callable[[dict[str, Any]], None]) -> bytes:
    """The same file with our part of its header changed."""
    (size,) = struct.unpack("<Q", blob[:8])
    outer = json.loads(blob[8 : 8 + size])
    header = json.loads(outer["__metadata__"]["appl_policy"])
    change(header)
    outer["__metadata__"]["appl_policy"] = json.dumps(header)
    text = json.dumps(outer).encode()
    text += b" " * (-len(text) % 8)
    return struct.pack("<Q", len(text)) + text + blob[8 + size :]


def test_everything_comes_back(tmp_path: Path) -> None:
    saved = mlp(space=DWA_WIDE)
    saved.save(tmp_path / "new" / "policy.safetensors")
    found = PolicyFile.load(tmp_path / "new" / "policy.safetensors")
    for a, b in zip((*saved.weights, *saved.biases), (*found.weights, *found.biases), strict=True):
        np.testing.assert_array_equal(a, b)
    assert (found.epoch, found.version, found.transitions) == (2, 7, 123)
    assert found.space == DWA_WIDE
    assert [p.name for p in (tmp_path / "new").iterdir()] == ["policy.safetensors"]


def test_half_the_bytes_give_the_same_policy_within_float16s_rounding() -> None:
    policy = mlp()
    blob = policy.to_bytes(half=True)
    assert len(blob) < 0.6 * len(policy.to_bytes())
    got = PolicyFile.from_bytes(blob)
    assert (got.epoch, got.version, got.transitions) == (2, 7, 123)
    for sent, arrived in zip(policy.weights + policy.biases, got.weights + got.biases, strict=True):
        assert arrived.dtype == np.float32
        np.testing.assert_allclose(arrived, sent, rtol=2.0**-11, atol=2.0**-24)
    large = mlp(biases=(np.full(6, 7e4, np.float32), np.zeros(8, np.float32)))
    with pytest.raises(ValueError, match=r"bias\.0: holds a value beyond float16"):
        large.to_bytes(half=True)


def test_fixed_values_of_an_own_space_come_back() -> None:
    space = ParameterSpace(
        "own", "mine", (Parameter("gain", 1.0, 0.5, 2.0, "1/s"), Parameter("count", 3, 1, 5, "", True))
    )
    found = PolicyFile.from_bytes(PolicyFile(values=np.array([1.5, 4.0]), space=space).to_bytes())
    assert found.space == space
    assert found.values is not None
    assert found.values.tolist() == [1.5, 4.0]


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"version": -1}, "version: got -1"),
        ({"weights": ()}, "weights: got no layer"),
        ({"biases": ()}, "biases: got 0; 2 weights need as many"),
        ({"values": DWA.defaults}, "values: given beside weights"),
        ({"weights": (), "biases": (), "values": DWA.defaults * 10}, r"max_vel_x = 5; dwa allows 0\.2\.\.2"),
        ({"weights": (), "biases": (), "values": DWA.defaults + 0.05}, "vx_samples = 6.05; it must be a whole number"),
        ({"biases": (np.zeros(6, np.float32), np.full(8, np.nan, np.float32))}, r"bias\.1: holds a value"),
        ({"biases": (np.zeros(6), np.zeros(8, np.float32))}, r"bias\.0: got dtype float64"),
        ({"biases": (np.zeros(6, np.float32), np.zeros(7, np.float32))}, r"bias\.1: got shape \(7,\)"),
        ({"weights": (np.zeros((6, 5), np.float32), np.zeros((8, 6), np.float32))}, r"weight\.0: got shape \(6, 5\)"),
        (
            {
                "weights": (np.zeros((3, OBSERVATION_SIZE), np.float32),),
                "biases": (np.zeros(3, np.float32),),
            },
            "gives 3 outputs; space 'dwa' has 8",
        ),
    ],
)
def test_a_policy_that_cannot_be_names_the_field(change: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        mlp(**change)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda h: h.update(format=9), "format: got 9; this version reads 3"),
        (lambda h: h.update(version="7"), "version: got '7'; expected int"),
        (lambda h: h.update(version=True), "version: got True; expected int"),
        (lambda h: h.pop("space"), "space: missing from the header"),
        (lambda h: h.update(layers=3), "tensors: got"),
        (lambda h: h.update(layers=10**9), "layers: got 1000000000; allowed"),
        (lambda h: h.update(activation="tanh"), "activation: got 'tanh'; allowed 'relu'"),
        (lambda h: h["observation"].update(clip_m=-1.0), "observation.clip_m: got -1.0"),
        (lambda h: h["observation"].update(size=700), "scan of 720 entries in 700"),
        (lambda h: h.pop("observation"), "observation: got none; a network needs"),
        (lambda h: h["space"].pop("planner"), r"space\.planner: missing"),
        (lambda h: h["space"]["parameters"][1].update(low="a"), r"space\.parameters\[1\]\.low: got 'a'"),
    ],
)
def test_a_header_that_cannot_be_is_refused_naming_file_and_field(
    change: Callable[[dict[str, Any]], None], message: str
) -> None:
    blob = with_header(mlp().to_bytes(), change)
    with pytest.raises(UserError, match=rf"^some\.file: not a usable policy: .*{message}"):
        PolicyFile.from_bytes(blob, "some.file")


def test_damaged_bytes_are_refused() -> None:
    blob = mlp().to_bytes()
    for bad in (b"", b"abc", blob[:100], blob[:-4], blob + b"x", b"\xff" * 200, b"\x00" * 64):
        with pytest.raises(UserError, match="not a usable policy"):
            PolicyFile.from_bytes(bad)


def test_files_that_cannot_be_read_or_written_are_named(tmp_path: Path) -> None:
    with pytest.raises(UserError, match=r"none: cannot read policy file: No such file"):
        PolicyFile.load(tmp_path / "none")
    (tmp_path / "file").write_text("")
    with pytest.raises(UserError, match="policy: cannot be written"):
        mlp().save(tmp_path / "file" / "policy")
