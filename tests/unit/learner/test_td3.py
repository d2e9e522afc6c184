from __future__ import annotations

import dataclasses
import itertools
import logging
import math

import numpy as np
import pytest
import torch
from torch import nn

from appl_dist.errors import UserError
from appl_dist.learner import td3
from appl_dist.learner.row_layout import Batch
from appl_dist.learner.settings import TD3Settings
from appl_dist.learner.td3 import TD3, Diverged, read
from appl_dist.planner.dwa import DWA
from appl_dist.policy.network import MLPPolicy
from appl_dist.policy_file import PolicyFile
from tests.paper_sizes import LAYOUT, OBSERVATION_SIZE

SMALL = TD3Settings(hidden=(32, 32), batch_size=64, actor_lr=3e-3, critic_lr=3e-3, precision="fp32")


def random_batch(rng: np.random.Generator, b: int = 64, obs: int = 4, act: int = 2) -> Batch:
    def uniform(*shape: int) -> np.ndarray:
        return rng.uniform(-1, 1, shape).astype(np.float32)

    return Batch(uniform(b, obs), uniform(b, act), uniform(b), np.full(b, 0.9, np.float32), uniform(b, obs))


def bandit_batch(rng: np.random.Generator) -> Batch:
    """One-step episodes whose best action is the observation itself: reward -|a - s|^2."""
    batch = random_batch(rng, obs=2)
    returns = -np.square(batch.actions - batch.observations).sum(1)
    return dataclasses.replace(batch, returns=returns, discounts=np.zeros_like(returns))


def greedy(learner: TD3, obs: np.ndarray) -> np.ndarray:
    action: np.ndarray = learner.actor(torch.from_numpy(obs)).detach().numpy()
    return action


def flat(net: nn.Module) -> torch.Tensor:
    """A copy of all parameters of `net` in one vector, layer by layer, weights (out, in) before biases."""
    return torch.nn.utils.parameters_to_vector(net.parameters()).detach().clone()


def fill(net: nn.Module, numbers: list[float] | float) -> None:
    """Set all parameters, in the order of `flat`."""
    count = len(flat(net))
    vector = torch.full((count,), numbers) if isinstance(numbers, float) else torch.tensor(numbers)
    assert len(vector) == count
    with torch.no_grad():
        torch.nn.utils.vector_to_parameters(vector, net.parameters())


def normal(learner: TD3, *shape: int) -> torch.Tensor:
    return torch.randn(shape, generator=learner.noise)


@pytest.mark.parametrize("precision", ["fp32", "bf16"])
def test_it_learns_to_copy_the_observation(precision: str) -> None:
    learner = TD3(dataclasses.replace(SMALL, precision=precision), 2, 2, seed=1)
    rng = np.random.default_rng(0)
    for _ in range(1500):
        metrics = learner.update(bandit_batch(rng))
    obs = random_batch(rng, 500, obs=2).observations * 0.9
    assert np.abs(greedy(learner, obs) - obs).mean() < 0.1
    assert read(metrics)["loss/critic"] < 0.02


def test_it_learns_the_value_of_a_state_that_repeats() -> None:
    # Reward 1 for ever at discount 0.5: the value is 2, whatever the action.
    learner = TD3(dataclasses.replace(SMALL, polyak=0.05), 2, 2, seed=0)
    rng = np.random.default_rng(0)
    for _ in range(600):
        batch = random_batch(rng, obs=2)
        ones = np.ones(64, np.float32)
        learner.update(dataclasses.replace(batch, returns=ones, discounts=ones / 2))
    batch = random_batch(rng, obs=2)
    value = learner.critic(torch.from_numpy(batch.observations), torch.from_numpy(batch.actions)).mean()
    torch.testing.assert_close(value.detach(), torch.tensor(2.0), atol=0.1, rtol=0)


@pytest.mark.parametrize("precision", ["fp32", "bf16"])
def test_two_runs_of_one_seed_are_bit_equal_and_of_two_seeds_not(precision: str) -> None:
    def run(seed: int) -> torch.Tensor:
        learner = TD3(dataclasses.replace(SMALL, precision=precision), 4, 2, seed=seed)
        rng = np.random.default_rng(0)
        for _ in range(20):
            learner.update(random_batch(rng))
        return torch.cat((flat(learner.actor), flat(learner.critic), flat(learner.critic_target)))

    assert torch.equal(run(3), run(3))
    assert not torch.equal(run(3), run(4))


def test_the_policy_and_all_targets_change_every_second_update() -> None:
    learner = TD3(dataclasses.replace(SMALL, policy_delay=2), 4, 2)
    rng = np.random.default_rng(0)
    names = ("critic", "actor", "actor_target", "critic_target")
    changes = []
    for _ in range(4):
        before = {name: flat(getattr(learner, name)) for name in names}
        learner.update(random_batch(rng))
        changes.append([not torch.equal(before[name], flat(getattr(learner, name))) for name in names])
    assert changes == [[True, False, False, False], [True, True, True, True]] * 2


def test_targets_are_polyak_averages() -> None:
    learner = TD3(dataclasses.replace(SMALL, polyak=0.25, policy_delay=1), 4, 2)
    for net, target in ((learner.actor, learner.actor_target), (learner.critic, learner.critic_target)):
        fill(net, 8.0)
        fill(target, 4.0)
    learner.average_targets()
    for target in (learner.actor_target, learner.critic_target):
        assert (flat(target) == 5.0).all()  # 0.25 * 8 + 0.75 * 4
    assert (flat(learner.critic) == 8.0).all()


def test_the_target_takes_the_smaller_critic_and_discounts_it() -> None:
    learner = TD3(SMALL, 4, 2)
    fill(learner.critic_target, 0.0)
    for q, bias in ((learner.critic_target.q1, 3.0), (learner.critic_target.q2, -2.0)):
        q.linears()[-1].bias.data.fill_(bias)  # Q1 = 3, Q2 = -2 everywhere
    found = learner.target(torch.tensor([1.0, 1.0]), torch.tensor([0.5, 0.0]), torch.zeros(2, 4), torch.zeros(2, 2))
    assert found.tolist() == [0.0, 1.0]  # 1 + 0.5 * -2; a terminal keeps its reward


def smoothed_actions(noise: float, clip: float, bias: float, count: int = 20_000) -> torch.Tensor:
    """(count,) the first component of the action the target critics are asked about."""
    settings = dataclasses.replace(SMALL, target_noise=noise, target_noise_clip=clip)
    learner = TD3(settings, 4, 2)
    fill(learner.actor_target, 0.0)
    learner.actor_target.mlp.linears()[-1].bias.data[0] = bias
    seen: list[torch.Tensor] = []
    learner.critic_target.register_forward_pre_hook(lambda _, inputs: seen.append(inputs[1]))
    learner.target(torch.zeros(count), torch.zeros(count), torch.zeros(count, 4), normal(learner, count, 2))
    return seen[0][:, 0]


def test_target_smoothing_is_clipped_noise_around_the_target_policy() -> None:
    action = smoothed_actions(noise=0.2, clip=0.5, bias=math.atanh(0.25))
    assert float((action - 0.25).mean()) == pytest.approx(0.0, abs=0.01)
    assert float((action - 0.25).std()) == pytest.approx(0.2, rel=0.03)
    assert float((action - 0.25).abs().max()) == pytest.approx(0.5)
    near_the_edge = smoothed_actions(noise=0.2, clip=0.5, bias=math.atanh(0.95))
    assert float(near_the_edge.max()) == 1.0  # an executable action
    exact = smoothed_actions(noise=0.0, clip=0.5, bias=math.atanh(0.25), count=3)
    torch.testing.assert_close(exact, torch.full((3,), 0.25))


def by_hand(vector: torch.Tensor, sizes: tuple[int, ...], x: torch.Tensor) -> torch.Tensor:
    """(b, out) of a ReLU network with the parameters of `flat`, from matrix products alone."""
    at = 0
    for i, (n, m) in enumerate(itertools.pairwise(sizes)):
        weight, at = vector[at : at + n * m].view(m, n), at + n * m
        x, at = x @ weight.T + vector[at : at + m], at + m
        x = x.relu() if i < len(sizes) - 2 else x
    return x


def test_one_update_equals_a_plain_definition() -> None:
    learner = TD3(dataclasses.replace(SMALL, policy_delay=1, target_noise=0.0), 4, 2)
    batch = random_batch(np.random.default_rng(0))
    obs, action = torch.from_numpy(batch.observations), torch.from_numpy(batch.actions)
    critics = [flat(q).requires_grad_() for q in (learner.critic.q1, learner.critic.q2)]
    actor = flat(learner.actor).requires_grad_()

    def q(vector: torch.Tensor, a: torch.Tensor) -> torch.Tensor:
        return by_hand(vector, (6, 32, 32, 1), torch.cat((obs, a), 1))[:, 0]

    arrays = (batch.returns, batch.discounts, batch.next_observations)
    y = learner.target(*(torch.from_numpy(a) for a in arrays), torch.zeros(64, 2))
    loss = sum((q(vector, action) - y).square().mean() for vector in critics)
    assert isinstance(loss, torch.Tensor)
    gradients = torch.autograd.grad(loss, critics)
    for vector, gradient in zip(critics, gradients, strict=True):
        vector.grad = gradient
    torch.optim.Adam(critics, SMALL.critic_lr).step()
    actor_loss = -q(critics[0].detach(), by_hand(actor, (4, 32, 32, 2), obs).tanh()).mean()
    actor.grad = torch.autograd.grad(actor_loss, actor)[0]
    torch.optim.Adam([actor], SMALL.actor_lr).step()

    found = read(learner.update(batch))
    assert found["loss/critic"] == pytest.approx(loss.item(), rel=1e-5)
    assert found["loss/actor"] == pytest.approx(actor_loss.item(), rel=1e-4)
    pairs = ((critics[0], learner.critic.q1), (critics[1], learner.critic.q2), (actor, learner.actor))
    for vector, net in pairs:
        assert vector.grad is not None
        found_gradient = torch.cat([p.grad.flatten() for p in net.parameters() if p.grad is not None])
        torch.testing.assert_close(found_gradient, vector.grad, atol=1e-6, rtol=1e-3)
        # Adam's first step is lr * sign(gradient): compare where the gradient is not rounding noise.
        clear = vector.grad.abs() > 1e-6
        torch.testing.assert_close(flat(net)[clear], vector.detach()[clear], atol=1e-4, rtol=1e-4)


def scalar_learner() -> TD3:
    """One number for state, action and hidden unit, with parameters that fit on paper.

    pi'(s) = tanh(0.5 relu(s)); Q'_1(s, a) = 2 relu(s + a) + 1; Q'_2(s, a) = 3 relu(s - a).
    """
    settings = dataclasses.replace(SMALL, hidden=(1,), policy_delay=2, polyak=0.1)
    learner = TD3(settings, 1, 1, seed=4)
    fill(learner.actor_target, [1.0, 0.0, 0.5, 0.0])
    fill(learner.critic_target.q1, [1.0, 1.0, 0.0, 2.0, 1.0])
    fill(learner.critic_target.q2, [1.0, -1.0, 0.0, 3.0, 0.0])
    return learner


def test_a_worked_example_of_the_papers_target() -> None:
    noise = [1.5, -4.0]  # the second is clipped
    found = scalar_learner().target(
        torch.tensor([0.5, -1.0]), torch.tensor([0.9, 0.0]), torch.tensor([[0.8], [0.3]]), torch.tensor(noise)[:, None]
    )
    wanted = []
    for reward, discount, s, epsilon in zip([0.5, -1.0], [0.9, 0.0], [0.8, 0.3], noise, strict=True):
        a = math.tanh(0.5 * s) + min(max(0.2 * epsilon, -0.5), 0.5)
        a = min(max(a, -1.0), 1.0)
        wanted.append(reward + discount * min(2 * max(s + a, 0.0) + 1, 3 * max(s - a, 0.0)))
    assert found.tolist() == pytest.approx(wanted, rel=1e-6)
    assert wanted[0] != 0.5 and wanted[1] == -1.0


def test_a_worked_example_of_delay_and_averaging() -> None:
    learner = scalar_learner()
    rng = np.random.default_rng(0)
    learner.update(random_batch(rng, obs=1, act=1))
    assert flat(learner.actor_target).tolist() == [1.0, 0.0, 0.5, 0.0]  # an odd update: the critics only
    learner.update(random_batch(rng, obs=1, act=1))
    old = [1.0, 0.0, 0.5, 0.0]
    wanted = [0.1 * new + 0.9 * before for new, before in zip(flat(learner.actor).tolist(), old, strict=True)]
    assert flat(learner.actor_target).tolist() == pytest.approx(wanted, rel=1e-6)


def test_weights_scale_each_error_in_the_critics_gradient() -> None:
    batch = random_batch(np.random.default_rng(0))
    weights = np.zeros(64, np.float32)
    weights[:32] = 2.0  # twice the first half: the mean over 64 is that over the first 32 alone
    settings = dataclasses.replace(SMALL, target_noise=0.0)
    weighted, half = TD3(settings, 4, 2), TD3(settings, 4, 2)
    weighted.update(dataclasses.replace(batch, weights=weights))
    half.update(Batch(*(a[:32] for a in (
        batch.observations, batch.actions, batch.returns, batch.discounts, batch.next_observations))))  # fmt: skip
    for a, b in zip(weighted.critic.parameters(), half.critic.parameters(), strict=True):
        torch.testing.assert_close(a.grad, b.grad, atol=1e-6, rtol=1e-4)
    assert weighted.errors.shape == (64,)


def test_the_policys_step_leaves_the_critics_alone() -> None:
    learner = TD3(SMALL, 4, 2)
    learner.update(random_batch(np.random.default_rng(0)))
    before, gradients = flat(learner.critic), [p.grad for p in learner.critic.parameters()]
    learner._update_actor_and_targets(torch.zeros(8, 4))
    assert torch.equal(flat(learner.critic), before)
    assert all(p.grad is g for p, g in zip(learner.critic.parameters(), gradients, strict=True))


def test_every_tensor_stays_on_the_device_and_nothing_waits_for_it(monkeypatch: pytest.MonkeyPatch) -> None:
    # The meta device holds no numbers: a tensor left on the CPU, or one read by the host, is an error.
    monkeypatch.setattr(td3, "_usable", lambda _: torch.device("meta"))
    monkeypatch.setattr(td3.torch, "Generator", lambda *_: torch.default_generator)
    monkeypatch.setattr(TD3, "_to_device", lambda self, array: torch.from_numpy(array).to(self.device))
    # Fused Adam knows no meta tensors.
    monkeypatch.setattr(td3, "_adam", lambda net, rate: torch.optim.SGD(net.parameters(), rate))
    learner = TD3(SMALL, 4, 2)
    rng = np.random.default_rng(0)
    for _ in range(4):
        metrics = learner.update(random_batch(rng), detail=True)
    assert {m.device.type for m in metrics.values()} == {"meta"}
    assert learner.errors.device.type == "meta"


def test_the_exported_policy_is_the_actor() -> None:
    learner = TD3(dataclasses.replace(SMALL, hidden=(512, 512, 512)), OBSERVATION_SIZE, 8)
    policy = MLPPolicy(PolicyFile(*learner.policy_arrays(), space=DWA, observation=LAYOUT))
    obs = np.random.default_rng(0).uniform(-1, 1, (20, OBSERVATION_SIZE)).astype(np.float32)
    found = np.stack([policy.act(o) for o in obs])
    np.testing.assert_allclose(found, greedy(learner, obs), atol=1e-5)


def test_exported_arrays_do_not_change_with_training() -> None:
    learner = TD3(SMALL, 4, 2)
    weights, biases = learner.policy_arrays()
    kept = [a.copy() for a in (*weights, *biases)]
    rng = np.random.default_rng(0)
    for _ in range(4):
        learner.update(random_batch(rng))
    assert all(np.array_equal(a, b) for a, b in zip(kept, (*weights, *biases), strict=True))
    assert not np.array_equal(learner.policy_arrays()[0][0], weights[0])


def test_detail_adds_norms_and_saturation() -> None:
    learner = TD3(SMALL, 4, 2)
    fill(learner.actor, 0.0)
    learner.actor.mlp.linears()[-1].bias.data = torch.tensor([5.0, 0.0])
    found = read(learner.update(random_batch(np.random.default_rng(0)), detail=True))
    assert (found["saturation/0"], found["saturation/1"]) == (1.0, 0.0)
    assert found["norm/actor"] == 5.0
    assert found["norm/critic_gradient"] > 0.0


def test_an_update_leaves_the_callers_arithmetic_alone() -> None:
    learner = TD3(SMALL, 4, 2)
    learner.update(random_batch(np.random.default_rng(0)))
    assert np.float32(1e-38) / np.float32(10) > 0  # denormals, which the update flushes to 0


def test_divergence_is_named() -> None:
    learner = TD3(SMALL, 4, 2)
    learner.critic.q1.linears()[0].weight.data[0, 0] = math.nan
    with pytest.raises(Diverged, match="loss/critic is nan"):
        read(learner.update(random_batch(np.random.default_rng(0))))


def test_emulated_bfloat16_is_warned_about(monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture) -> None:
    monkeypatch.setattr(td3.torch.cpu, "_is_amx_tile_supported", lambda: False)
    monkeypatch.setattr(td3.torch.cpu, "_is_avx512_bf16_supported", lambda: False)
    with caplog.at_level(logging.WARNING):
        assert TD3(dataclasses.replace(SMALL, precision="auto"), 4, 2).precision == "fp32"
        assert not caplog.records
        assert TD3(dataclasses.replace(SMALL, precision="bf16"), 4, 2).precision == "bf16"
    assert "precision: bf16 is emulated" in caplog.text


def test_a_device_that_is_not_there_is_named() -> None:
    with pytest.raises(UserError, match=r"device: 'cuda:99' cannot be used: .*; allowed cpu, cuda"):
        TD3(dataclasses.replace(SMALL, device="cuda:99"), 4, 2)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"hidden": ()}, "hidden: got"),
        ({"policy_delay": 0}, "policy_delay: got 0"),
        ({"actor_lr": 0.0}, "actor_lr: got 0"),
        ({"polyak": 1.5}, "polyak: got 1.5"),
        ({"target_noise": -0.1}, "target_noise: got -0.1"),
        ({"device": "gpu"}, "device: got 'gpu'; allowed cpu, cuda, cuda:N"),
        ({"precision": "fp16"}, "precision: got 'fp16'; allowed auto, bf16, fp32"),
    ],
)
def test_settings_that_cannot_be_are_named(change: dict, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        TD3Settings(**change)
