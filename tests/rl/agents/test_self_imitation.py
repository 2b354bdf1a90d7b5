"""The actor's pull towards what it did once, where that brought more than is expected of it now."""

import pytest
import torch

from nerf_rl.errors import UserError
from nerf_rl.rl.agents.ddpg import DDPG
from nerf_rl.rl.config import LearnerConfig, NetworkConfig
from nerf_rl.rl.experience.replay import Batch

UNKNOWN = torch.finfo(torch.float32).min
DONE, SCALE = 0.7, 0.5


def made(weight: float) -> DDPG:
    """Return an agent whose critic says 2 of every action, so that nothing else draws the actor anywhere."""
    torch.manual_seed(0)
    learner = LearnerConfig(
        imitation_weight=weight, actor_rate=3e-3, reward_scale=SCALE, pre_tanh_penalty=0.0, actor_batch="prioritised"
    )
    agent = DDPG(3, 2, NetworkConfig(hidden=[32, 32], standardise=False), learner)
    torch.nn.init.zeros_(agent.critic.head.weight)
    torch.nn.init.constant_(agent.critic.head.bias, 2.0)
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


def test_the_actor_does_again_what_brought_more_than_is_expected_of_it() -> None:
    assert (action_after(made(1.0), bound=10.0) - DONE).abs().max() < 0.05


@pytest.mark.parametrize("bound", [2.0 / SCALE, -10.0, UNKNOWN], ids=["as much", "less", "unknown"])
def test_what_brought_no_more_is_not_imitated(bound: float) -> None:
    agent = made(1.0)
    before = agent.actor(batch(bound).observation).detach()
    assert torch.equal(action_after(agent, bound, updates=3), before)
    assert agent.update_actor(batch(bound))["surplus"] == 0.0


def test_the_loss_is_the_mean_of_surplus_times_squared_distance() -> None:
    agent, b = made(0.3), batch(10.0)
    b = b._replace(bound=torch.linspace(-20.0, 20.0, 16))
    distance = (agent.actor(b.observation) - b.action).square().mean(-1).detach()
    surplus = (SCALE * b.bound - 2.0).clamp(min=0.0)
    metrics = agent.update_actor(b)
    assert metrics["surplus"] == pytest.approx(float(surplus.mean()))
    assert metrics["actor_loss"] == pytest.approx(-2.0 + 0.3 * float((surplus * distance).mean()), abs=1e-5)


def test_without_a_weight_nothing_is_imitated() -> None:
    agent = made(0.0)
    before = agent.actor(batch(10.0).observation).detach()
    assert torch.equal(action_after(agent, 10.0, updates=3), before)


@pytest.mark.parametrize(
    ("keys", "uses"), [({}, False), ({"imitation_weight": 0.1}, True), ({"bound_by_returns": True}, True)]
)
def test_returns_are_kept_for_what_learns_from_them(keys: dict, uses: bool) -> None:
    assert LearnerConfig(**keys).uses_returns is uses


def test_ends_can_be_steady_only_where_returns_are_used() -> None:
    with pytest.raises(UserError, match=r"--learner\.bound_by_returns or --learner\.imitation_weight"):
        LearnerConfig(steady_ends=True)
    assert LearnerConfig(steady_ends=True, imitation_weight=0.1).steady_ends


def test_targets_are_bounded_only_if_asked_for() -> None:
    errors = []
    for bounded in (False, True):
        agent = made(0.1)
        agent.learner.bound_by_returns = bounded
        _, error = agent.update_critic(batch(100.0))
        errors.append(error)
    assert torch.allclose(errors[0], torch.full((16,), 2.0)) and torch.allclose(errors[1], torch.full((16,), 48.0))
