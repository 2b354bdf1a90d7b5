"""Deep deterministic policy gradient (Lillicrap et al. 2016) with n-step returns and prioritised replay."""

import contextlib
import copy
from collections.abc import Iterable

import torch
from jaxtyping import Float
from numpy import ndarray
from torch import Tensor, nn

from nerf_rl.rl.agents.networks import Actor, Critic
from nerf_rl.rl.agents.normalisation import RunningNorm
from nerf_rl.rl.config import LearnerConfig, NetworkConfig
from nerf_rl.rl.experience.replay import Batch, Replay

Metrics = dict[str, float]


@torch.no_grad()
def soft_update(network: nn.Module, target: nn.Module, tau: float) -> None:
    """Move the target's parameters by the share ``tau`` towards the network's; copy buffers (batch statistics)."""
    torch._foreach_lerp_(list(target.parameters()), list(network.parameters()), tau)
    for buffer, source in zip(target.buffers(), network.buffers(), strict=True):
        buffer.copy_(source)


class DDPG:
    """An agent: ``act``, and ``update`` from replay.

    Args:
        observation_size, action_size: O and A; actions are in [-1, 1].
        network: widths and normalisation.
        learner: the algorithm's constants.
        device: of the networks, PyTorch's default one if None; observations, actions and replay are the CPU's.
    """

    def __init__(
        self,
        observation_size: int,
        action_size: int,
        network: NetworkConfig,
        learner: LearnerConfig,
        device: torch.device | str | None = None,
    ):
        self.learner = learner
        with contextlib.nullcontext() if device is None else torch.device(device):
            self.norm: nn.Module = RunningNorm(observation_size) if network.standardise else nn.Identity()
            self.actor = Actor(observation_size, action_size, network)
            self.critic = Critic(observation_size, action_size, network)
        self.target_actor = copy.deepcopy(self.actor).requires_grad_(False).eval()
        self.target_critic = copy.deepcopy(self.critic).requires_grad_(False).eval()
        self.actor_optimiser = torch.optim.Adam(self.actor.parameters(), lr=learner.actor_rate, fused=True)
        self.critic_optimiser = torch.optim.Adam(self.critic.parameters(), lr=learner.critic_rate, fused=True)
        self.actor.eval()
        self.critic.eval()
        self.updates = 0

    @property
    def device(self) -> torch.device:
        """Where the networks are."""
        return next(self.actor.parameters()).device

    @torch.no_grad()
    def act(self, observation: Float[ndarray, "E O"]) -> Float[ndarray, "E A"]:
        """Return the policy's actions, without noise."""
        return self.actor(self.norm(torch.from_numpy(observation).to(self.device))).cpu().numpy()

    def update_statistics(self, observation: Float[ndarray, "E O"]) -> None:
        """Take fresh observations into the statistics that standardise them."""
        if isinstance(self.norm, RunningNorm):
            self.norm.update_statistics(observation)

    def update(self, replay: Replay, beta: float) -> Metrics:
        """Do one step of critic, actor and targets; return what happened.

        Args:
            replay: memory to draw from; it receives the new priorities.
            beta: exponent of the importance weights.
        """
        batch = self._standardise(replay.sample(beta))
        critic_metrics, error = self.update_critic(batch)
        replay.update_priority(batch.indices, error.cpu())
        soft_update(self.critic, self.target_critic, self.learner.tau)
        self.updates += 1
        if self.updates % self.learner.actor_every:
            return critic_metrics
        own = self.learner.actor_batch == "uniform" and replay.prioritised
        observation = self.norm(replay.sample_observations().to(self.device)) if own else batch.observation
        actor_metrics = self.update_actor(observation)
        soft_update(self.actor, self.target_actor, self.learner.tau)
        return critic_metrics | actor_metrics

    def update_critic(self, batch: Batch) -> tuple[Metrics, Float[Tensor, "B"]]:
        """Fit Q(s, a) to the n-step target; return metrics and the absolute temporal-difference errors.

        delta_i = sum_k gamma^k r_k + discount_i Q'(s_n, mu'(s_n)) - Q(s, a), loss = mean_i w_i delta_i^2.
        """
        with torch.no_grad():
            next_value = self.target_critic(batch.next_observation, self.target_actor(batch.next_observation))
            target = self.learner.reward_scale * batch.reward + batch.discount * next_value
        self.critic.train()
        value = self.critic(batch.observation, batch.action)
        self.critic.eval()
        error = target - value
        loss = (batch.weight * error.square()).mean()
        gradient = self._step(self.critic_optimiser, loss, self.critic.parameters())
        error = error.detach().abs()
        metrics = {
            "critic_loss": loss.item(),
            "q": value.mean().item(),
            "td_error": error.mean().item(),
            "critic_gradient": gradient,
        }
        return metrics, error

    def update_actor(self, observation: Float[Tensor, "B O"]) -> Metrics:
        """Climb Q(s, mu(s)); the critic's parameters are held still and receive no gradient."""
        self.critic.requires_grad_(False)
        self.actor.train()
        pre_tanh = self.actor.pre_tanh(observation)
        self.actor.eval()
        magnitude = pre_tanh.square().mean()
        loss = -self.critic(observation, torch.tanh(pre_tanh)).mean() + self.learner.pre_tanh_penalty * magnitude
        gradient = self._step(self.actor_optimiser, loss, self.actor.parameters())
        self.critic.requires_grad_(True)
        return {"actor_loss": loss.item(), "pre_tanh": magnitude.item() ** 0.5, "actor_gradient": gradient}

    def _standardise(self, batch: Batch) -> Batch:
        """Return a batch on the networks' device, all but the places, with standardised observations."""
        batch = Batch(batch.indices, *(tensor.to(self.device) for tensor in batch[1:]))
        observation, next_observation = self.norm(batch.observation), self.norm(batch.next_observation)
        return batch._replace(observation=observation, next_observation=next_observation)

    def _step(self, optimiser: torch.optim.Optimizer, loss: Tensor, parameters: Iterable[nn.Parameter]) -> float:
        optimiser.zero_grad(set_to_none=True)
        loss.backward()
        norm = nn.utils.clip_grad_norm_(parameters, self.learner.max_grad_norm, foreach=True)
        optimiser.step()
        return norm.item()
