"""Matrix products in C against torch's, in float64 from the same bfloat16 numbers."""

from __future__ import annotations

from typing import Any

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from torch import Tensor

from appl_dist import _native

pytestmark = pytest.mark.skipif(not _native.has_tiles(), reason="this processor has no AMX tiles")
SIZE = st.integers(1, 70)


def draw(generator: torch.Generator, rows: int, columns: int, stored_transposed: bool = False) -> Tensor:
    """(rows, columns) as it is stored: a part of something larger."""
    shape = (columns, rows + 3) if stored_transposed else (rows, columns + 3)
    return torch.randn(shape, generator=generator).bfloat16()[:, :-3]


def close(found: Tensor, wanted: Tensor) -> None:
    torch.testing.assert_close(found.double(), wanted, rtol=2**-8, atol=1e-4)


@settings(deadline=None)  # the first call loads torch
@given(SIZE, SIZE, SIZE, st.booleans(), st.booleans(), st.integers(0, 1000))
def test_a_product_equals_torchs(m: int, n: int, k: int, turn_a: bool, turn_b: bool, seed: int) -> None:
    generator = torch.Generator().manual_seed(seed)
    a, b = draw(generator, m, k, turn_a), draw(generator, k, n, turn_b)
    bias, rest, open_ = draw(generator, 1, n), draw(generator, m, min(k, 33)), draw(generator, m, n)
    exact = (a.t() if turn_a else a).double() @ (b.t() if turn_b else b).double()
    out = torch.full((m, n + 2), 7.0).bfloat16()
    inside = out[:, :n]

    def run(**fused: Any) -> Tensor:
        _native.Product(a, b, inside, transpose_a=turn_a, transpose_b=turn_b, **fused)()
        assert (out[:, n:] == 7.0).all()
        return inside

    close(run(), exact)
    close(run(bias=bias, relu=True), (exact + bias.double()).relu())
    close(run(open=open_), exact * (open_ > 0))
    if not turn_a and not turn_b:
        close(run(rest=rest), exact + rest.double() @ b[-rest.shape[1] :].double())
    if not turn_b:
        sums = torch.empty(1, n).bfloat16()
        run(sums=sums)
        close(sums, b.double().sum(0, keepdim=True))


def test_what_is_not_a_number_stays_so() -> None:
    ones = torch.ones(2, 2).bfloat16()
    a = torch.tensor([[torch.nan, 0.0], [-1.0, 0.0]]).bfloat16()
    out = torch.empty_like(a)
    _native.Product(a, ones, out, relu=True)()
    assert out[0].isnan().all()
    assert (out[1] == 0).all()


@pytest.mark.parametrize(
    ("change", "error", "words"),
    [
        ({"a": torch.zeros(4, 5)}, TypeError, "a: expected bfloat16"),
        ({"a": torch.zeros(5, 4).bfloat16().t()}, ValueError, "a: expected .rows, columns."),
        ({"b": torch.zeros(4, 6).bfloat16()}, ValueError, r"b: expected \(5, 6\), got \(4, 6\)"),
        ({"out": torch.zeros(4, 5).bfloat16()}, ValueError, r"out: expected \(4, 6\)"),
        ({"bias": torch.zeros(1, 5).bfloat16()}, ValueError, r"bias: expected \(1, 6\)"),
        ({"rest": torch.zeros(4, 6).bfloat16()}, ValueError, r"rest: expected \(4, 5\), got \(4, 6\)"),
        ({"rest": torch.zeros(4, 1).bfloat16(), "b": torch.zeros(6, 5).bfloat16(), "transpose_b": True},
         ValueError, "rest: only"),
        ({"open": torch.zeros(6, 4).bfloat16()}, ValueError, r"open: expected \(4, 6\)"),
        ({"sums": torch.zeros(2, 6).bfloat16()}, ValueError, r"sums: expected \(1, 6\)"),
        ({"b": torch.zeros(6, 5).bfloat16(), "transpose_b": True, "sums": torch.zeros(1, 6)}, ValueError, "sums"),
    ],
)  # fmt: skip
def test_what_does_not_fit_is_refused(change: dict[str, Any], error: type[Exception], words: str) -> None:
    arguments = {
        "a": torch.zeros(4, 5).bfloat16(),
        "b": torch.zeros(5, 6).bfloat16(),
        "out": torch.zeros(4, 6).bfloat16(),
    }
    _native.Product(**arguments)()
    with pytest.raises(error, match=words):
        _native.Product(**{**arguments, **change})
