"""The actor's pull towards what it did once, where that brought more than episodes do on the mean."""

from typing import Literal

import pytest
import torch

from nerf_rl.rl.agents.ddpg import DDPG
from nerf_rl.rl.config import LearnerConfig, NetworkConfig
from nerf_rl.rl.experience.replay import Batch

UNKNOWN = torch.finfo(torch.float32).min
DONE, SCALE, MEAN = 0.7, 0.5, 2.0


def made(weight: float, expected: float = 50.0) -> DDPG:
    """Return an agent whose critic says the same of every action, so that nothing else draws the actor anywhere.

    Episodes are known to bring ``MEAN`` on the mean, wherever they go on from.
    """
    torch.manual_seed(0)
    learner = LearnerConfig(
        imitation_weight=weight, actor_rate=3e-3, reward_scale=SCALE, pre_tanh_penalty=0.0, actor_batch="prioritised"
    )
    agent = DDPG(3, 2, NetworkConfig(hidden=[32, 32], standardise=False), learner)
    torch.nn.init.zeros_(agent.critic.head.weight)
    torch.nn.init.constant_(agent.critic.head.bias, expected)
    if agent.mean_return:
        torch.nn.init.zeros_(agent.mean_return.head.weight)
        torch.nn.init.constant_(agent.mean_return.head.bias, MEAN)
    return agent


def still(agent: DDPG) -> DDPG:
    """Let the mean stay what it is."""
    assert agent.return_optimiser is not None
    agent.return_optimiser.param_groups[0]["lr"] = 0.0
    return agent


def batch(bound: float) -> Batch:
    size = 16
    observation = torch.randn(size, 3, generator=torch.Generator().manual_seed(1))
    zeros, action = torch.zeros(size), torch.full((size, 2), DONE)
    return Batch(torch.arange(size), zeros, observation, action, zeros, zeros, observation, torch.full((size,), bound))


def action_after(agent: DDPG, bound: float, updates: int = 200) -> torch.Tensor:
    for _ in range(updates):
        agent.update_actor(batch(bound))
    return agent.actor(batch(bound).observation).detach()


@pytest.mark.parametrize(("expected", "bound"), [(50.0, 10.0), (-10.0, MEAN / SCALE - 1.0)], ids=["mean", "critic"])
def test_the_actor_does_again_what_brought_more_than_the_mean_or_than_is_expected(
    expected: float, bound: float
) -> None:
    assert (action_after(still(made(1.0, expected)), bound) - DONE).abs().max() < 0.05


@pytest.mark.parametrize("bound", [MEAN / SCALE, -10.0, UNKNOWN], ids=["as much", "less", "unknown"])
def test_what_brought_no_more_is_not_imitated(bound: float) -> None:
    agent = still(made(1.0))
    before = agent.actor(batch(bound).observation).detach()
    assert torch.equal(action_after(agent, bound, updates=3), before)
    assert agent.update_actor(batch(bound))["surplus"] == 0.0


def test_the_loss_is_the_mean_of_surplus_times_squared_distance() -> None:
    agent, b = made(0.3), batch(10.0)
    b = b._replace(bound=torch.linspace(-20.0, 20.0, 16))
    distance = (agent.actor(b.observation) - b.action).square().mean(-1).detach()
    surplus = (SCALE * b.bound - MEAN).clamp(min=0.0)
    metrics = agent.update_actor(b)
    assert metrics["surplus"] == pytest.approx(float(surplus.mean()))
    assert metrics["actor_loss"] == pytest.approx(-50.0 + 0.3 * float((surplus * distance).mean()), abs=1e-4)


def test_the_mean_is_that_of_what_is_known() -> None:
    agent, b = made(1.0), batch(0.0)
    assert agent.mean_return is not None
    unknown = torch.arange(16) % 2 == 0
    b = b._replace(bound=torch.where(unknown, UNKNOWN, b.observation.sum(-1)))
    for _ in range(400):
        agent.update_actor(b)
    error = (agent.mean_return(b.observation) - SCALE * b.bound)[~unknown]
    assert error.abs().max() < 0.1 and agent.update_actor(b)["surplus"] < 0.05


@pytest.mark.parametrize("kind", ["none", "layer", "batch"])
def test_the_mean_goes_with_a_checkpoint_and_starts_anew_with_the_networks(
    kind: Literal["none", "layer", "batch"],
) -> None:
    config = NetworkConfig(hidden=[8, 8], normalisation=kind)
    agent, again = (DDPG(3, 2, config, LearnerConfig(imitation_weight=1.0)) for _ in range(2))
    assert agent.mean_return is not None and again.mean_return is not None
    for _ in range(3):
        agent.update_actor(batch(10.0))
    assert not agent.mean_return.training
    again.load_state_dict({name: tensor.clone() for name, tensor in agent.state_dict().items()})
    assert torch.equal(again.mean_return(batch(0.0).observation), agent.mean_return(batch(0.0).observation))
    surplus = [each.update_actor(batch(20.0))["surplus"] for each in (agent, again)]
    assert surplus[0] == surplus[1]
    assert torch.equal(again.mean_return(batch(0.0).observation), agent.mean_return(batch(0.0).observation))
    learnt = agent.mean_return
    agent.reset()
    assert agent.mean_return is not learnt
    assert not any(name.startswith("mean_return") for name in DDPG(3, 2, config, LearnerConfig()).state_dict())


def test_without_a_weight_nothing_is_imitated() -> None:
    agent = made(0.0)
    before = agent.actor(batch(10.0).observation).detach()
    assert torch.equal(action_after(agent, 10.0, updates=3), before)


@pytest.mark.parametrize(
    ("keys", "uses"), [({}, False), ({"imitation_weight": 0.1}, True), ({"bound_by_returns": True}, True)]
)
def test_returns_are_kept_for_what_learns_from_them(keys: dict, uses: bool) -> None:
    assert LearnerConfig(**keys).uses_returns is uses


def test_targets_are_bounded_only_if_asked_for() -> None:
    errors = []
    for bounded in (False, True):
        agent = made(0.1)
        agent.learner.bound_by_returns = bounded
        _, error = agent.update_critic(batch(50.0 / SCALE))
        errors.append(error)
    assert torch.allclose(errors[0], torch.full((16,), 50.0)) and torch.allclose(errors[1], torch.zeros(16))
