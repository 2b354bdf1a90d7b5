"""Signs of an agent that has stopped learning."""

import json

import pytest
import torch

from nerf_rl.rl.agents.diagnosis import diagnose
from nerf_rl.rl.agents.networks import Actor, Critic
from nerf_rl.rl.config import NetworkConfig
from nerf_rl.rl.training.deadlock import STRUCTURE, DeadlockMonitor


def networks() -> tuple[Actor, Critic]:
    torch.manual_seed(0)
    config = NetworkConfig(hidden=[16, 16])
    return Actor(3, 2, config), Critic(3, 2, config)


def test_fresh_networks_have_no_dead_units_and_no_flat_actions() -> None:
    signs = diagnose(*networks(), torch.randn(256, 3))
    assert signs["saturated"] == 0.0 and signs["dead_units"] < 0.1 and signs["action_gradient"] > 0


def test_saturated_actions_dead_units_and_a_flat_critic_are_seen() -> None:
    actor, critic = networks()
    with torch.no_grad():
        actor.head.bias.copy_(torch.tensor([10.0, 0.0]))
        actor.trunk[1].bias[:8] = -100.0  # half of one of four hidden layers
        critic.head.weight.zero_()
    signs = diagnose(actor, critic, torch.randn(256, 3))
    assert signs["saturated"] == pytest.approx(0.5)
    assert signs["dead_units"] == pytest.approx(1 / 8, abs=0.03)
    assert signs["action_gradient"] == 0.0
    assert all(parameter.grad is None for parameter in (*actor.parameters(), *critic.parameters()))


def monitor(returns: list[float], successes: tuple[int, ...] | None = None) -> DeadlockMonitor:
    watch = DeadlockMonitor()
    for episode, value in enumerate(returns):
        watch.end_episode(100 * (episode + 1), value, None if successes is None else episode in successes)
    return watch


def test_a_rising_return_counts_as_better_and_noise_does_not() -> None:
    rising = [float(i) for i in range(40)]
    assert monitor(rising).stuck_for(4000) == 0
    flat = [100.0 + (i % 2) for i in range(40)]
    assert monitor([*rising, *flat]).stuck_for(8000) == pytest.approx(2900, abs=200)
    watch = monitor(flat)
    watch.forgive(3500)
    assert watch.stuck_for(4000) == 500


def test_where_success_is_told_it_alone_counts() -> None:
    rising = [float(i) for i in range(40)]
    assert monitor(rising, successes=()).stuck_for(4000) == 4000
    assert monitor(rising, successes=(10, 30)).stuck_for(4000) == 900


def test_a_resumed_run_goes_on_counting() -> None:
    returns = [float(i % 13) for i in range(60)]
    whole, first = monitor(returns), monitor(returns[:35])
    state = json.loads(json.dumps(first.state_dict()))
    STRUCTURE(state, "monitor")
    again = DeadlockMonitor()
    again.load_state_dict(state)
    for episode, value in enumerate(returns[35:], 35):
        again.end_episode(100 * (episode + 1), value, None)
    assert again.state_dict() == whole.state_dict()


def test_a_monitor_that_has_seen_nothing_can_be_stored() -> None:
    state = json.loads(json.dumps(DeadlockMonitor().state_dict()))
    STRUCTURE(state, "monitor")
    again = DeadlockMonitor()
    again.load_state_dict(state)
    assert again.state_dict() == state
