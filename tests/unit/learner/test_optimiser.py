"""One step of Adam and of Polyak averaging against torch, for every way they are computed."""

from __future__ import annotations

import pytest
import torch

from appl_dist import _native
from appl_dist.learner import optimiser
from appl_dist.learner.networks import FlatMLP
from appl_dist.learner.optimiser import Adam, average
from appl_dist.learner.workers import Workers

DTYPES = [torch.float32, torch.bfloat16]


def network(dtype: torch.dtype, seed: int = 0) -> FlatMLP:
    return FlatMLP((9, 33, 17, 2), 2, torch.Generator().manual_seed(seed), torch.device("cpu"), dtype)


def fill(net: FlatMLP, generator: torch.Generator) -> torch.Tensor:
    """Random gradients; as one float32 vector."""
    for part in net.parts:
        part.grad.copy_(torch.randn(part.grad.shape, generator=generator))
    return torch.cat([part.grad.float() for part in net.parts])


def kernels(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    if name == "torch":  # what runs on other devices
        monkeypatch.setattr(optimiser, "_adam_native", optimiser._adam_torch)
        monkeypatch.setattr(optimiser, "_average_native", optimiser._average_torch)


@pytest.mark.parametrize("kernel", ["native", "torch"])
@pytest.mark.parametrize("threads", [1, 3])
@pytest.mark.parametrize("dtype", DTYPES)
def test_adam_equals_torchs(dtype: torch.dtype, threads: int, kernel: str, monkeypatch: pytest.MonkeyPatch) -> None:
    kernels(kernel, monkeypatch)
    net = network(dtype)
    adam = Adam(net, 1e-2, Workers(threads))
    wanted = net.flat.clone()
    reference = torch.optim.Adam([wanted], 1e-2)
    generator = torch.Generator().manual_seed(1)
    for _ in range(20):
        wanted.grad = fill(net, generator)
        adam.step()
        reference.step()
    torch.testing.assert_close(net.flat, wanted, atol=1e-6, rtol=1e-5)
    assert adam.steps == 20
    for layer, master in zip(net.layers, net.master, strict=True):
        assert torch.equal(layer.weight, master.weight.to(layer.weight.dtype))
        assert torch.equal(layer.bias, master.bias.to(layer.bias.dtype))


@pytest.mark.parametrize("dtype", DTYPES)
def test_the_number_of_threads_changes_no_bit(dtype: torch.dtype) -> None:
    results = []
    for threads in (1, 2, 5):
        net = network(dtype)
        adam = Adam(net, 1e-2, Workers(threads))
        generator = torch.Generator().manual_seed(1)
        for _ in range(5):
            fill(net, generator)
            adam.step()
        results.append(net.flat)
    assert torch.equal(results[0], results[1]) and torch.equal(results[0], results[2])


@pytest.mark.parametrize("kernel", ["native", "torch"])
@pytest.mark.parametrize("dtype", DTYPES)
def test_averaging_is_the_papers_equation(dtype: torch.dtype, kernel: str, monkeypatch: pytest.MonkeyPatch) -> None:
    kernels(kernel, monkeypatch)
    net, target = network(dtype, 1), network(dtype, 2)
    wanted = 0.25 * net.flat + 0.75 * target.flat
    average(target, net, 0.25, Workers(2))
    torch.testing.assert_close(target.flat, wanted, atol=1e-7, rtol=1e-6)
    assert torch.equal(target.layers[0].weight, target.master[0].weight.to(dtype))


def test_native_rounding_to_bfloat16_is_torchs() -> None:
    bits = torch.randint(-(2**31), 2**31 - 1, (100_000,), dtype=torch.int32, generator=torch.Generator().manual_seed(0))
    values = torch.cat((bits.view(torch.float32), torch.tensor([torch.inf, -torch.inf, torch.nan, 0.0, -0.0, 3.4e38])))
    copy = torch.empty(len(values), dtype=torch.bfloat16)
    _native.polyak(values, values.clone(), copy.view(torch.uint16), tau=0.0)
    finite = values.isfinite()
    assert torch.equal(copy[finite].view(torch.int16), values[finite].bfloat16().view(torch.int16))
    assert copy[values.isnan()].isnan().all()


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"gradient": torch.zeros(4)}, "gradient: expected shape"),
        ({"gradient": torch.zeros(5, dtype=torch.float64)}, "gradient: wrong dtype"),
        ({"copy": torch.zeros(5)}, "copy: wrong dtype"),
        ({"step": 0}, "step: counts from 1"),
    ],
)
def test_native_arguments_are_checked(change: dict, message: str) -> None:
    arguments = {
        "parameters": torch.zeros(5), "gradient": torch.zeros(5), "first_moment": torch.zeros(5),
        "second_moment": torch.zeros(5), "copy": None, "step": 1, "rate": 0.1, "beta1": 0.9, "beta2": 0.99,
        "epsilon": 1e-8,
    }  # fmt: skip
    with pytest.raises((ValueError, TypeError), match=message):
        _native.adam(**{**arguments, **change})
