from __future__ import annotations

import pytest
import torch
from torch import Tensor, nn

from appl_dist.learner.networks import MLP, Actor, TwinCritic

SIZES = (7, 16, 12, 3)


def plain(net: MLP, x: Tensor) -> Tensor:
    """The same network from torch's own modules."""
    first, second, last = net.linears()
    norm = nn.LayerNorm(16, elementwise_affine=False) if net.layer_norm else nn.Identity()
    norm2 = nn.LayerNorm(12, elementwise_affine=False) if net.layer_norm else nn.Identity()
    found: Tensor = nn.Sequential(first, norm, nn.ReLU(), second, norm2, nn.ReLU(), last)(x)
    return found


@pytest.mark.parametrize("layer_norm", [False, True])
def test_inputs_side_by_side_equal_one_input_in_value_and_gradient(layer_norm: bool) -> None:
    torch.manual_seed(0)
    net = MLP(SIZES, bf16=False, layer_norm=layer_norm)
    x = torch.randn(50, 7, requires_grad=True)
    wanted = plain(net, x)
    by_x, by_first = torch.autograd.grad(wanted.square().sum(), (x, net.linears()[0].weight))
    for pieces in ([x], x.split([5, 2], 1), x.split([1, 4, 2], 1)):
        found = net(*pieces)
        torch.testing.assert_close(found, wanted)
        found_by = torch.autograd.grad(found.square().sum(), (x, net.linears()[0].weight))
        torch.testing.assert_close(found_by[0], by_x)
        torch.testing.assert_close(found_by[1], by_first)


def test_bf16_rounds_the_hidden_layers_and_nothing_else() -> None:
    torch.manual_seed(0)
    exact = MLP((40, 64, 64, 2), bf16=False)
    rounded = MLP((40, 64, 64, 2), bf16=True)
    rounded.load_state_dict(exact.state_dict())
    x = torch.randn(100, 40)
    difference = (exact(x) - rounded(x)).abs().max() / exact(x).abs().max()
    assert 1e-5 < float(difference.detach()) < 2e-2
    assert rounded(x).dtype == torch.float32
    assert {p.dtype for p in rounded.parameters()} == {torch.float32}
    for layer in rounded.linears():
        layer.weight.data.zero_()
    rounded.linears()[-1].bias.data.fill_(1.001)  # bfloat16 would make it 1
    assert float(rounded(x)[0, 0].detach()) == pytest.approx(1.001)


def test_the_policy_stays_in_its_box() -> None:
    actor = Actor(SIZES, bf16=False)
    for parameter in actor.parameters():
        parameter.data.mul_(100.0)
    assert float(actor(torch.randn(100, 7)).detach().abs().max()) <= 1.0


def test_the_critics_differ_and_the_first_alone_equals_the_first_of_both() -> None:
    torch.manual_seed(0)
    critic = TwinCritic((7, 16, 12, 1), bf16=False, layer_norm=False)
    observation, action = torch.randn(5, 4), torch.randn(5, 3)
    both = critic(observation, action)
    assert both.shape == (2, 5)
    assert not torch.equal(both[0], both[1])
    torch.testing.assert_close(critic.first(observation, action), both[0])


def test_initial_weights_are_uniform_within_one_over_root_fan_in() -> None:
    torch.manual_seed(0)
    for layer in MLP((7, 160, 120, 300), bf16=False).linears():
        bound = layer.in_features**-0.5
        for tensor in (layer.weight.detach(), layer.bias.detach()):
            assert 0.9 * bound < float(tensor.abs().max()) <= bound
            assert abs(float(tensor.mean())) < 0.2 * bound
