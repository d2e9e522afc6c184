from __future__ import annotations

import pytest
import torch
from torch import Tensor

from appl_dist.learner import products
from appl_dist.learner.networks import FlatMLP
from appl_dist.learner.passes import FINE
from appl_dist.learner.workers import Workers

SIZES = (7, 16, 12, 3)


def network(dtype: torch.dtype = torch.float32, heads: int = 2, normalise: bool = False) -> FlatMLP:
    return FlatMLP(SIZES, heads, torch.Generator().manual_seed(0), torch.device("cpu"), dtype, normalise)


def gradient(net: FlatMLP) -> Tensor:
    return torch.cat([part.grad.float() for part in net.parts])


def by_autograd(net: FlatMLP, x: Tensor, weights: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """Output, gradient by `flat` and by x of (weights * output).sum(), from a plain definition."""
    flat = net.flat.detach().clone().requires_grad_()
    layers = net._layers(*flat.split([len(part.master) for part in net.parts]))
    x = x.clone().requires_grad_()
    outputs = []
    for head in range(net.heads):
        y = x
        for i, layer in enumerate(layers):
            y = y @ layer.weight[head] + layer.bias[head]
            if i < len(SIZES) - 2:
                y = (torch.nn.functional.layer_norm(y, y.shape[-1:]) if net.normalise else y).relu()
        outputs.append(y)
    output = torch.stack(outputs)
    by_flat, by_x = torch.autograd.grad((weights * output).sum(), (flat, x))
    return output.detach(), by_flat, by_x


@pytest.mark.parametrize(
    ("dtype", "normalise", "tolerance"),
    [
        (torch.float32, False, 1e-5),
        (torch.float32, True, 1e-5),
        (torch.bfloat16, False, 3e-2),
        (torch.bfloat16, True, 0.2),  # dividing by a small deviation enlarges the rounding
    ],
)
@pytest.mark.parametrize("in_c", [True, False])  # the same on a processor without tiles
def test_forward_and_backward_equal_autograd(
    dtype: torch.dtype, normalise: bool, tolerance: float, in_c: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    if not in_c:
        monkeypatch.setattr(products, "tiled", lambda *_: False)
    net = network(dtype, normalise=normalise)
    generator = torch.Generator().manual_seed(1)
    x = torch.randn(50, 7, generator=generator)
    weights = torch.randn(2, 50, 3, generator=generator)
    output, by_flat, by_x = by_autograd(net, x, weights)
    done = net.forward(x)
    net.backward(done, weights)

    def error(found: Tensor, wanted: Tensor) -> float:
        return float((found - wanted).norm() / wanted.norm())

    assert done.output.dtype == torch.float32
    assert error(done.output, output) < tolerance
    assert error(gradient(net), by_flat) < tolerance
    assert error(net.input_gradient(done, weights, 7), by_x) < tolerance
    assert error(net.input_gradient(done, weights, 2), by_x[:, -2:]) < tolerance
    assert float(net.gradient_norm()) == pytest.approx(float(by_flat.norm()), rel=tolerance)


@pytest.mark.parametrize("heads", [1, 2])
@pytest.mark.parametrize("dtype", [torch.float32, torch.bfloat16])
def test_the_number_of_threads_changes_no_bit(dtype: torch.dtype, heads: int) -> None:
    found = []
    for threads in (1, 2, 5):
        generator = torch.Generator().manual_seed(0)
        net = FlatMLP((70, 65, 40, 3), heads, generator, torch.device("cpu"), dtype, workers=Workers(threads))
        done = net.forward(torch.randn(50, 70, generator=generator))
        net.backward(done, torch.randn(heads, 50, 3, generator=generator))
        alone = net.forward(torch.ones(1, 70))  # fewer rows than threads
        found.append(torch.cat((done.output.flatten(), alone.output.flatten(), gradient(net))))
    assert torch.equal(found[0], found[1])
    assert torch.equal(found[0], found[2])


def test_the_first_head_alone_equals_the_first_of_both() -> None:
    net = network()
    x = torch.randn(5, 7, generator=torch.Generator().manual_seed(1))
    both, one = net.forward(x), net.forward(x, heads=1)
    torch.testing.assert_close(one.output, both.output[:1])
    by_output = torch.ones(2, 5, 3)
    by_output[1] = 0
    torch.testing.assert_close(net.input_gradient(one, by_output[:1], 3), net.input_gradient(both, by_output, 3))


def test_the_input_gradient_leaves_the_optimisers_gradient_alone() -> None:
    net = network()
    done = net.forward(torch.ones(5, 7))
    net.input_gradient(done, torch.ones(2, 5, 3), 2)
    assert not gradient(net).any()


@pytest.mark.parametrize("dtype", [torch.float32, torch.bfloat16])
def test_a_change_of_the_flat_vector_shows_after_refresh(dtype: torch.dtype) -> None:
    net = network(dtype)
    net.flat.zero_()
    net.refresh()
    assert not net.forward(torch.ones(5, 7)).output.any()


@pytest.mark.parametrize("in_c", [True, False])
def test_bfloat16_sees_what_rounding_takes_from_the_last_inputs(in_c: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    if not in_c:
        monkeypatch.setattr(products, "tiled", lambda *_: False)
    net = FlatMLP((FINE + 20, 64, 1), 1, torch.Generator().manual_seed(0), torch.device("cpu"), torch.bfloat16)
    x = torch.ones(1, FINE + 20)
    for column, seen in ((0, False), (19, False), (20, True), (FINE + 19, True)):
        moved = x.clone()
        moved[0, column] += 2.0**-9  # a quarter of what bfloat16 resolves there
        before, after = (net.forward(y[:, :30], y[:, 30:]).output.clone() for y in (x, moved))
        assert bool((before != after).all()) == seen, column


def test_initial_weights_are_uniform_within_one_over_root_fan_in() -> None:
    for layer in network(heads=50).master:
        bound = layer.weight.shape[1] ** -0.5
        for tensor in layer:
            assert tensor.abs().max() <= bound
            assert tensor.abs().max() > 0.9 * bound
            assert abs(float(tensor.mean())) < 0.1 * bound
