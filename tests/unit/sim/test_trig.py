"""The simulator's own sine and cosine: within an ulp of the exact values, and the same bits on every machine."""

from __future__ import annotations

import ctypes
import hashlib
import subprocess
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

HEADER = Path(__file__).parents[3] / "appl_dist/sim/csrc/trig.h"
CODE = """#include "trig.h"
void each(const double *x, long n, double *s, double *c) {
    for (long i = 0; i < n; ++i) trig_sincos(x[i], s + i, c + i);
}
"""
Pair = tuple[NDArray[np.float64], NDArray[np.float64]]


@pytest.fixture(scope="module", params=["-O0", "-O3"])
def sincos(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Callable[..., Pair]:
    folder = tmp_path_factory.mktemp("trig")
    (folder / "each.c").write_text(CODE)
    library = folder / "each.so"
    flags = [request.param, "-ffp-contract=off", "-shared", "-fPIC", f"-I{HEADER.parent}"]
    subprocess.run(["cc", *flags, "-o", str(library), str(folder / "each.c")], check=True)
    each = ctypes.CDLL(str(library)).each

    def call(x: NDArray[np.float64]) -> Pair:
        s, c = np.empty_like(x), np.empty_like(x)
        each(*(ctypes.c_void_p(a.ctypes.data) for a in (x,)), ctypes.c_long(len(x)),
             *(ctypes.c_void_p(a.ctypes.data) for a in (s, c)))  # fmt: skip
        return s, c

    return call


@pytest.mark.parametrize("largest", [1e-3, 1.0, 4.0, 100.0, 1e5])
def test_sine_and_cosine_are_within_an_ulp(sincos: Callable[..., Pair], largest: float) -> None:
    x = np.random.default_rng(0).uniform(-largest, largest, 200_000)
    exact = x.astype(np.longdouble)
    for found, wanted in zip(sincos(x), (np.sin(exact), np.cos(exact)), strict=True):
        error = np.abs(found - wanted) / np.spacing(np.abs(wanted.astype(np.float64)))
        assert error.max() <= 1.0


def test_sine_and_cosine_of_multiples_of_a_quarter_turn(sincos: Callable[..., Pair]) -> None:
    x = np.arange(-1000, 1001) * (np.pi / 2)
    for found, wanted in zip(sincos(x), (np.sin(x), np.cos(x)), strict=True):
        assert np.abs(found - wanted).max() <= 2e-16
    assert sincos(np.zeros(1)) == (0.0, 1.0)


def test_sine_and_cosine_have_the_bits_of_every_other_machine(sincos: Callable[..., Pair]) -> None:
    x = np.arange(-50_000, 50_000) / 1024.0
    digest = hashlib.sha256(b"".join(a.astype("<f8").tobytes() for a in sincos(x))).hexdigest()
    assert digest[:16] == "d5c86267b587e024"  # x86-64, GCC 12
