"""The learner: gradients go where they should, targets follow, values converge to what can be calculated."""

import copy
from pathlib import Path

import numpy as np
import pytest
import torch

from nerf_rl.rl.agents.ddpg import DDPG, Target
from nerf_rl.rl.agents.networks import Actor, Critic
from nerf_rl.rl.agents.normalisation import RunningNorm
from nerf_rl.rl.config import LearnerConfig, NetworkConfig, ReplayConfig
from nerf_rl.rl.experience.n_step import Transition
from nerf_rl.rl.experience.replay import Batch, Replay


def agent(observation_size: int = 3, action_size: int = 2, **keys: object) -> DDPG:
    torch.manual_seed(0)
    network = NetworkConfig(hidden=[32, 32], normalisation=str(keys.pop("normalisation", "layer")))
    return DDPG(observation_size, action_size, network, LearnerConfig(batch_size=16, **keys))


def batch(size: int = 16, weight: torch.Tensor | None = None) -> Batch:
    g = torch.Generator().manual_seed(1)
    o, n = torch.randn(size, 3, generator=g), torch.randn(size, 3, generator=g)
    action, reward = torch.rand(size, 2, generator=g), torch.randn(size, generator=g)
    weight = torch.ones(size) if weight is None else weight
    bound = torch.full((size,), torch.finfo(torch.float32).min)
    return Batch(torch.arange(size), weight, o, action, reward, torch.full((size,), 0.9), n, bound)


def parameters(module: torch.nn.Module) -> list[torch.Tensor]:
    return [p.detach().clone() for p in module.parameters()]


def same(a: list[torch.Tensor], b: list[torch.Tensor]) -> bool:
    return all(torch.equal(x, y) for x, y in zip(a, b, strict=True))


def test_the_networks_are_those_of_the_paper() -> None:
    actor, critic = Actor(7, 4, NetworkConfig()), Critic(7, 4, NetworkConfig())
    linear = {
        name: tuple(p.shape) for name, p in (*actor.named_parameters(), *critic.named_parameters()) if p.ndim == 2
    }
    assert linear == {
        "trunk.0.weight": (256, 7),
        "trunk.3.weight": (400, 256),
        "head.weight": (1, 400),
        "observe.0.weight": (256, 7),
        "join.0.weight": (400, 256 + 4),
    }
    bound = np.sqrt(6.0 / (260 + 400))
    weight = critic.join[0].weight
    assert 0.99 * bound < weight.abs().max() <= bound
    assert critic(torch.randn(5, 7), torch.randn(5, 4)).shape == (5,)
    assert actor(torch.randn(5, 7)).abs().max() < 0.1, "actions start near the centre of tanh"


@pytest.mark.parametrize("kind", ["layer", "batch", "none"])
def test_every_normalisation_learns_and_acts_on_a_single_observation(kind: str) -> None:
    learner = agent(normalisation=kind)
    learner.update_critic(batch())
    learner.update_actor(batch())
    Target(learner.critic, 0.5).follow()
    assert learner.act(np.zeros((1, 3), np.float32)).shape == (1, 2)


def test_a_target_moves_by_tau_and_repeats_to_a_geometric_series() -> None:
    network = torch.nn.Linear(3, 2)
    target, start = Target(network, 0.1), network.weight.detach().clone()
    with torch.no_grad():
        network.weight += 1.0
    for _ in range(5):
        target.follow()
    assert torch.allclose(target.copy.weight, network.weight + 0.9**5 * (start - network.weight))


def test_the_actors_step_leaves_the_critic_alone_and_the_critics_step_the_actor() -> None:
    learner = agent()
    critic, actor = parameters(learner.critic), parameters(learner.actor)
    learner.update_actor(batch())
    assert same(critic, parameters(learner.critic)) and not same(actor, parameters(learner.actor))
    assert all(p.grad is None and p.requires_grad for p in learner.critic.parameters())
    actor = parameters(learner.actor)
    targets = parameters(learner.target_actor) + parameters(learner.target_critic)
    learner.update_critic(batch())
    assert same(actor, parameters(learner.actor)) and not same(critic, parameters(learner.critic))
    assert same(targets, parameters(learner.target_actor) + parameters(learner.target_critic))


def test_the_critics_loss_is_the_weighted_mean_of_squared_errors_element_by_element() -> None:
    learner = agent(reward_scale=0.5)
    b = batch(weight=torch.linspace(0.1, 1.0, 16))
    with torch.no_grad():
        next_value = learner.target_critic(b.next_observation, learner.target_actor(b.next_observation))
        value = learner.critic(b.observation, b.action)
    by_hand = [0.5 * b.reward[i] + 0.9 * next_value[i] - value[i] for i in range(16)]
    metrics, error = learner.update_critic(b)
    assert error.shape == (16,)
    assert torch.allclose(error, torch.stack(by_hand).abs(), atol=1e-6)
    assert metrics["critic_loss"] == pytest.approx(
        float(sum(w * d**2 for w, d in zip(b.weight, by_hand, strict=True)) / 16)
    )


def test_a_transition_with_weight_zero_teaches_nothing() -> None:
    learner = agent()
    before = parameters(learner.critic)
    learner.update_critic(batch(weight=torch.zeros(16)))
    assert same(before, parameters(learner.critic))


def test_long_gradients_are_shortened() -> None:
    learner = agent(max_grad_norm=1e-3, reward_scale=1000.0)
    metrics, _ = learner.update_critic(batch())
    norm = torch.stack([p.grad.norm() for p in learner.critic.parameters()]).norm()
    assert metrics["critic_gradient"] > 1e-3
    assert float(norm) == pytest.approx(1e-3, rel=1e-3)


def test_the_penalty_pulls_saturated_actions_back() -> None:
    learner = agent(pre_tanh_penalty=10.0, actor_rate=1e-2)
    torch.nn.init.constant_(learner.actor.head.bias, 5.0)
    first = learner.update_actor(batch())["pre_tanh"]
    for _ in range(50):
        last = learner.update_actor(batch())["pre_tanh"]
    assert last < first - 0.3


def test_the_policy_that_is_kept_has_the_average_of_the_actors_weights(tmp_path: Path) -> None:
    learner = agent(1, 1, policy_average=4, actor_every=2, actor_rate=1e-2)
    replay = Replay(ReplayConfig(capacity=64), 1, 1, 16, tmp_path / "replay")
    rng = np.random.default_rng(0)
    replay.add([Transition(rng.normal(size=1), rng.uniform(-1, 1, 1), 1.0, 0.9, np.ones(1)) for _ in range(64)])
    average = parameters(learner.actor)
    for update in range(1, 13):
        learner.update(replay, beta=0.5)
        if update % 2 == 0:  # an update of the actor
            average = [mean + (now - mean) / 4 for mean, now in zip(average, parameters(learner.actor), strict=True)]
    kept = parameters(learner.policy()[1])
    assert all(torch.allclose(*pair, atol=1e-6) for pair in zip(average, kept, strict=True))
    assert not same(kept, parameters(learner.actor))
    learner.reset()
    assert same(parameters(learner.policy()[1]), parameters(learner.actor)), "fresh networks have no past"
    assert same(parameters(agent().policy()[1]), parameters(agent().actor)), "the last weights, unless asked for more"


def test_values_converge_to_the_analytic_ones_for_truncation_and_termination(tmp_path: Path) -> None:
    """Reward 1 for ever is worth 1 / (1 - gamma) if episodes are only truncated, and 1 if each step terminates."""
    for discount, worth in ((0.8, 5.0), (0.0, 1.0)):
        learner = agent(1, 1, gamma=0.8, tau=0.3, reward_scale=1.0, critic_rate=5e-3)
        learner.norm = torch.nn.Identity()
        replay = Replay(ReplayConfig(capacity=64), 1, 1, 16, tmp_path / f"replay{worth}")
        rng = np.random.default_rng(0)
        replay.add([Transition(np.zeros(1), rng.uniform(-1, 1, 1), 1.0, discount, np.zeros(1)) for _ in range(64)])
        for _ in range(250):
            metrics = learner.update(replay, beta=0.5)
        assert metrics["q"] == pytest.approx(worth, rel=0.05)


def test_the_actor_finds_the_best_action_of_a_bandit(tmp_path: Path) -> None:
    """Reward -(a - 0.6 s)^2 with s in {-1, 1}: the best action is 0.6 s."""
    learner = agent(1, 1, actor_rate=5e-3, critic_rate=5e-3, reward_scale=1.0, pre_tanh_penalty=0.0, actor_every=1)
    replay = Replay(ReplayConfig(capacity=512), 1, 1, 64, tmp_path / "replay")
    rng = np.random.default_rng(0)
    for _ in range(512):
        state, action = rng.choice([-1.0, 1.0], 1), rng.uniform(-1, 1, 1)
        replay.add([Transition(state, action, -float((action[0] - 0.6 * state[0]) ** 2), 0.0, state)])
    for _ in range(900):  # enough on any processor: rounding decides how quickly it gets there
        learner.update(replay, beta=1.0)
    action = learner.act(np.array([[-1.0], [1.0]], np.float32))
    assert action[:, 0] == pytest.approx([-0.6, 0.6], abs=0.12)


def test_running_statistics_are_those_of_all_observations_at_once() -> None:
    norm, x = RunningNorm(3), np.random.default_rng(0).normal([1.0, -2.0, 0.0], [3.0, 0.5, 0.0], (50, 3))
    for part in np.split(x, [1, 4, 20]):
        norm.update_statistics(part.astype(np.float32))
    assert norm.mean.numpy() == pytest.approx(x.mean(0), abs=1e-5)
    assert norm.std.numpy() == pytest.approx([*x.std(0)[:2], 0.01], abs=1e-5)
    standardised = norm(torch.from_numpy(x.astype(np.float32)))
    assert standardised.mean(0).abs().max() < 1e-4
    assert torch.equal(RunningNorm(3)(torch.ones(2, 3)), torch.ones(2, 3))


def test_targets_start_as_copies() -> None:
    learner = agent()
    assert same(parameters(learner.actor), parameters(learner.target_actor))
    assert copy.deepcopy(learner.critic).state_dict().keys() == learner.target_critic.state_dict().keys()


@pytest.mark.parametrize("whose", ["uniform", "prioritised"])
def test_the_actor_learns_from_the_batch_that_it_is_told_to(whose: str, tmp_path: Path) -> None:
    class Watched(DDPG):
        def update_critic(self, batch: Batch) -> tuple[dict[str, float], torch.Tensor]:
            self.of_critic = batch
            return super().update_critic(batch)

        def update_actor(self, batch: Batch, demonstrated: Batch | None = None) -> dict[str, float]:
            self.of_actor = batch
            return super().update_actor(batch, demonstrated)

    replay = Replay(ReplayConfig(capacity=64), 3, 2, 16, tmp_path / "replay")
    here = np.zeros(3, np.float32)
    replay.add([Transition(here, np.full(2, 0.1 * i, np.float32), 1.0, 0.9, here) for i in range(20)], 0)
    learner = LearnerConfig(actor_batch=whose, batch_size=16)
    made = Watched(3, 2, NetworkConfig(hidden=[16, 16], standardise=False), learner)
    made.update(replay, 1.0)
    assert (made.of_actor is made.of_critic) is (whose == "prioritised")
