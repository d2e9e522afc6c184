"""The network in C: its definition, exact tanh, and the same bits for every vector width."""

from __future__ import annotations

import ctypes
import hashlib
import platform
import subprocess
from collections.abc import Callable
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays
from numpy.typing import NDArray

from appl_dist._native import Network

Floats = NDArray[np.float32]
PACKAGE = Path(__file__).parents[3] / "appl_dist"
PANEL = 32
WIDTHS = ("x86-64", "x86-64-v3", "x86-64-v4") if platform.machine() == "x86_64" else ("native",)


def runs(march: str) -> bool:
    """Whether this processor runs code for `march`."""
    needs = {"x86-64-v3": {"avx2", "fma", "bmi2"}, "x86-64-v4": {"avx512f", "avx512bw", "avx512vl", "avx512dq"}}
    cpu = Path("/proc/cpuinfo").read_text().split()
    return needs.get(march, set()) <= set(cpu)


@pytest.fixture(scope="module", params=[("-O0", WIDTHS[0]), *(("-O3", width) for width in WIDTHS)], ids="".join)
def library(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> ctypes.CDLL:
    """network.c for one processor."""
    level, march = request.param
    if not runs(march):
        pytest.skip(f"this processor does not run {march}")
    made = tmp_path_factory.mktemp("network") / "network.so"
    folders = [f"-I{PACKAGE / 'policy/csrc'}", f"-I{PACKAGE / 'native'}"]
    flags = [level, f"-march={march}", "-ffp-contract=off", "-fno-math-errno", "-fno-trapping-math", "-DONE_WIDTH"]
    source = str(PACKAGE / "policy/csrc/network.c")
    subprocess.run(["cc", *flags, *folders, "-shared", "-fPIC", "-o", str(made), source], check=True)
    return ctypes.CDLL(str(made))


def pointer(array: NDArray[np.float32]) -> ctypes.c_void_p:
    return ctypes.c_void_p(array.ctypes.data)


def tanh(library: ctypes.CDLL, x: Floats) -> Floats:
    found = x.copy()
    library.network_tanh(pointer(found), ctypes.c_size_t(len(found)))
    return found


@pytest.mark.parametrize("largest", [1e-20, 1e-3, 0.5, 1.0, 12.0, 1e30])
def test_tanh_is_within_an_ulp(library: ctypes.CDLL, largest: float) -> None:
    x = np.random.default_rng(0).uniform(-largest, largest, 200_000).astype(np.float32)
    exact = np.tanh(x.astype(np.float64))
    assert (np.abs(tanh(library, x) - exact) <= np.spacing(np.abs(exact.astype(np.float32)))).all()


def test_tanh_of_special_values(library: ctypes.CDLL) -> None:
    x = np.array([0.0, -0.0, np.inf, -np.inf, np.nan, 1e-45, 3e38], np.float32)
    found = tanh(library, x)
    np.testing.assert_array_equal(found, np.array([0, 0, 1, -1, np.nan, 1e-45, 1], np.float32))


def test_layers_have_the_bits_of_every_other_machine(library: ctypes.CDLL) -> None:
    inputs, panels = 729, 3
    rng = np.random.default_rng(0)
    shapes = ((panels, inputs, PANEL), (panels * PANEL,), (inputs,))
    weights, biases, x = (rng.integers(-(2**20), 2**20, shape).astype(np.float32) / 2**20 for shape in shapes)
    digest = hashlib.sha256()
    for rectified in (0, 1):
        out = np.empty(panels * PANEL, np.float32)
        sizes = (ctypes.c_size_t(inputs), ctypes.c_size_t(panels), rectified)
        library.network_layer(pointer(weights), pointer(biases), pointer(x), *sizes, pointer(out))
        digest.update(out.tobytes())
    digest.update(tanh(library, np.arange(-20_000, 20_000, dtype=np.float32) / 1024).tobytes())
    assert digest.hexdigest()[:16] == "18c6a391efc096cb"  # x86-64, GCC 12


def native(layers: list[tuple[Floats, Floats]], x: Floats) -> Floats:
    network = Network()
    for weights, biases in layers:
        network.add(weights, biases)
    action = np.empty(len(layers[-1][1]), np.float32)
    network.act(x, action)
    return action


@settings(deadline=None, max_examples=200)
@given(st.lists(st.integers(1, 70), min_size=2, max_size=5), st.data())
def test_the_network_equals_its_definition(sizes: list[int], data: st.DataObject) -> None:
    def floats(shape: tuple[int, ...]) -> Floats:
        made: Floats = data.draw(
            arrays.arrays(np.float32, shape, elements=st.floats(-4, 4, width=32), fill=st.just(0.5))
        )
        return made

    layers = [(floats((o, i)), floats((o,))) for i, o in pairwise(sizes)]
    x = floats((sizes[0],))
    exact, bound = x.astype(np.float64), np.abs(x).astype(np.float64)
    error = np.zeros(len(x))
    for n, (w, b) in enumerate(layers):
        size = np.abs(w).astype(np.float64)
        error = size @ error + (w.shape[1] + 1) * 2.0**-24 * (size @ (bound + error) + np.abs(b))
        exact, bound = w @ exact + b, size @ bound + np.abs(b)
        if n < len(layers) - 1:
            exact = np.maximum(exact, 0)
    assert (np.abs(native(layers, x) - np.tanh(exact)) <= error + 2.0**-23).all()


def refused(call: Callable[[], object], match: str, kind: type[Exception] = ValueError) -> None:
    with pytest.raises(kind, match=match):
        call()


def test_layers_and_vectors_that_do_not_fit_are_refused() -> None:
    w, b = np.zeros((3, 5), np.float32), np.zeros(3, np.float32)
    network = Network()
    refused(lambda: network.act(b, b), "no layers")
    refused(lambda: network.add(w, np.zeros(4, np.float32)), r"biases: expected shape \(3\), got \(4\)")
    refused(lambda: network.add(w[:, ::2], b), "weights: expected a C-contiguous array")
    refused(lambda: network.add(w.astype(np.float64), b), "weights: wrong dtype", TypeError)
    network.add(w, b)
    refused(lambda: network.add(w, b), r"weights: expected shape \(n, 3\), got \(3, 5\)")
    refused(lambda: network.act(np.zeros(4, np.float32), b), r"observation: expected shape \(5\), got \(4\)")
    refused(lambda: network.act(np.zeros(5, np.float32), np.zeros(5, np.float32)), r"action: expected shape \(3\)")
