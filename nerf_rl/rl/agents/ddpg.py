"""Deep deterministic policy gradient (Lillicrap et al. 2016) with n-step returns and prioritised replay."""

import contextlib
import copy
from collections.abc import Iterator, Mapping
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Float
from numpy import ndarray
from torch import Tensor, nn
from torch.optim.swa_utils import get_ema_multi_avg_fn

from nerf_rl.rl.agents.diagnosis import diagnose
from nerf_rl.rl.agents.networks import Actor, Critic
from nerf_rl.rl.agents.normalisation import RunningNorm
from nerf_rl.rl.agents.state import flat_state, load_flat_state
from nerf_rl.rl.config import LearnerConfig, NetworkConfig
from nerf_rl.rl.experience.replay import Batch, Replay

Metrics = dict[str, float]
_DIAGNOSED = 256  # observations


class Target:
    """A network and its slow copy; to walk through their modules for each update would take as long as a layer.

    Args:
        network: to copy.
        tau: share of the network that enters the copy in each update.

    Attributes:
        copy: the slow copy, which receives no gradient.
    """

    def __init__(self, network: nn.Module, tau: float):
        self.copy = copy.deepcopy(network).requires_grad_(False).eval()
        self._average = get_ema_multi_avg_fn(1.0 - tau)
        self._parameters = list(self.copy.parameters()), list(network.parameters())
        self._statistics = list(zip(self.copy.buffers(), network.buffers(), strict=True))

    @torch.no_grad()
    def follow(self) -> None:
        """Move the copy's parameters by the share tau towards the network's; copy buffers (batch statistics)."""
        self._average(*self._parameters, None)
        for slow, statistics in self._statistics:
            slow.copy_(statistics)


class DDPG:
    """One deterministic actor and one critic, each with a target (:class:`nerf_rl.rl.agents.agent.Agent`).

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
        self.learner, self._network, self._sizes = learner, network, (observation_size, action_size)
        with contextlib.nullcontext() if device is None else torch.device(device):
            self.norm: nn.Module = RunningNorm(observation_size) if network.standardise else nn.Identity()
        self._has_batch_statistics = network.normalisation == "batch"
        self.updates = 0
        self._make_networks(device)

    def _make_networks(self, device: torch.device | str | None) -> None:
        network, learner = self._network, self.learner
        with contextlib.nullcontext() if device is None else torch.device(device):
            self.actor = Actor(*self._sizes, network)
            self.critic = Critic(*self._sizes, network)
        self._slow_actor, self._slow_critic = (Target(each, learner.tau) for each in (self.actor, self.critic))
        self.target_actor, self.target_critic = self._slow_actor.copy, self._slow_critic.copy
        self._average = Target(self.actor, 1.0 / learner.policy_average) if learner.policy_average else None
        self.actor_optimiser = torch.optim.Adam(self.actor.parameters(), lr=learner.actor_rate, fused=True)
        self.critic_optimiser = torch.optim.Adam(self.critic.parameters(), lr=learner.critic_rate, fused=True)
        self.actor.eval()
        self.critic.eval()

    def reset(self) -> None:
        """Start anew with fresh networks (Nikishin et al. 2022); statistics of observations stay."""
        self._make_networks(self.device)

    @property
    def device(self) -> torch.device:
        """Where the networks are."""
        return next(self.actor.parameters()).device

    @torch.no_grad()
    def act(self, observation: Float[ndarray, "E O"]) -> Float[ndarray, "E A"]:
        """Return the policy's actions, without noise."""
        return self.actor(self.norm(torch.from_numpy(observation).to(self.device))).cpu().numpy()

    @torch.no_grad()
    def value(self, observation: Float[ndarray, "O"]) -> float:
        """Return the discounted rewards, unscaled, that the targets expect from an observation on."""
        standardised = self.norm(torch.from_numpy(observation).to(self.device))[None]
        value = self.target_critic(standardised, self.target_actor(standardised))
        return value.item() / self.learner.reward_scale

    def update_statistics(self, observation: Float[ndarray, "E O"]) -> None:
        """Take fresh observations into the statistics that standardise them."""
        if isinstance(self.norm, RunningNorm):
            self.norm.update_statistics(observation)

    def diagnose(self, replay: Replay) -> Metrics:
        """Return signs of trouble all over memory, see :func:`nerf_rl.rl.agents.diagnosis.diagnose`.

        Nothing random is drawn: what is looked at must not change what is learnt.
        """
        rows = np.linspace(0, len(replay) - 1, _DIAGNOSED).astype(np.int64)
        observation = torch.from_numpy(replay.observations(rows)).to(self.device)
        return diagnose(self.actor, self.critic, self.norm(observation))

    def policy(self) -> nn.Sequential:
        """Return the network from raw observations [B, O] to actions [B, A] that is evaluated and kept.

        With ``learner.policy_average`` its weights are a running average of the actor's (Polyak and Juditsky 1992).
        """
        return nn.Sequential(self.norm, self._average.copy if self._average else self.actor)

    def state_dict(self) -> dict[str, Tensor]:
        """Return networks, targets and optimiser moments by flat names."""
        return flat_state(self._networks(), self._optimisers())

    def load_state_dict(self, tensors: Mapping[str, Tensor], source: Path = Path("the checkpoint")) -> None:
        """Put back what :meth:`state_dict` returned.

        Args:
            tensors: of a checkpoint.
            source: the checkpoint, to be named if it does not fit.

        Raises:
            MissingFileError: they are those of another agent.
        """
        load_flat_state(self._networks(), self._optimisers(), tensors, source)

    def update(self, replay: Replay, beta: float) -> Metrics:
        """Do one step of critic, actor and targets; return what happened.

        Args:
            replay: memory to draw from; it receives the new priorities.
            beta: exponent of the importance weights.
        """
        batch = self._standardise(replay.sample(beta))
        critic_metrics, error = self.update_critic(batch)
        replay.update_priority(batch.indices, error.cpu())
        self._slow_critic.follow()
        self.updates += 1
        if self.updates % self.learner.actor_every:
            return critic_metrics
        own = self.learner.actor_batch == "uniform" and replay.prioritised
        actor_batch = self._standardise(replay.sample_uniform()) if own else batch
        actor_metrics = self.update_actor(actor_batch, self._demonstrated(replay))
        self._slow_actor.follow()
        if self._average:
            self._average.follow()
        return critic_metrics | actor_metrics

    def update_critic(self, batch: Batch) -> tuple[Metrics, Float[Tensor, "B"]]:
        """Fit Q(s, a) to the n-step target; return metrics and the absolute temporal-difference errors.

        delta_i = sum_k gamma^k r_k + discount_i Q'(s_n, mu'(s_n)) - Q(s, a), loss = mean_i w_i delta_i^2.

        The target is not less than the batch's bound: what follows a step was done once, so that a policy that knows
        better than the present one can do it again (He et al. 2017, "optimality tightening").
        """
        with torch.no_grad():
            next_value = self.target_critic(batch.next_observation, self.target_actor(batch.next_observation))
            target = self.learner.reward_scale * batch.reward + batch.discount * next_value
            if self.learner.bound_by_returns:
                target = target.maximum(self.learner.reward_scale * batch.bound)
        with self._gathering(self.critic):
            value = self.critic(batch.observation, batch.action)
        error = target - value
        loss = (batch.weight * error.square()).mean()
        gradient = self._step(self.critic_optimiser, loss)
        error = error.detach().abs()
        metrics = {
            "critic_loss": loss.item(),
            "q": value.mean().item(),
            "td_error": error.mean().item(),
            "critic_gradient": gradient,
        }
        return metrics, error

    def update_actor(self, batch: Batch, demonstrated: Batch | None = None) -> Metrics:
        """Climb Q(s, mu(s)); the critic's parameters are held still and receive no gradient.

        Args:
            batch: standardised.
            demonstrated: not to go far from, for now: w mean|Q| mean (mu(s) - a)^2 joins the loss, after TD3+BC
                (Fujimoto and Gu 2021), with a weight w that falls to 0 over ``learner.clone_updates``.
        """
        with self._gathering(self.actor):
            pre_tanh = self.actor.pre_tanh(batch.observation)
            distance = None if demonstrated is None else self._distance(demonstrated)
        magnitude = pre_tanh.square().mean()
        action = torch.tanh(pre_tanh)
        value = self.critic(batch.observation, action)
        loss = -value.mean() + self.learner.pre_tanh_penalty * magnitude
        metrics = {}
        if self.learner.imitation_weight > 0:
            imitation, surplus = self._imitation(batch, action, value.detach())
            loss = loss + self.learner.imitation_weight * imitation
            metrics["surplus"] = surplus.item()
        if distance is not None:
            loss = loss + self._clone_weight() * value.detach().abs().mean() * distance
        gradient = self._step(self.actor_optimiser, loss)
        metrics |= {"actor_loss": loss.item(), "pre_tanh": magnitude.item() ** 0.5, "actor_gradient": gradient}
        return metrics

    def clone(self, replay: Replay) -> Metrics:
        """Draw the actor towards demonstrated actions, and fit the critic to what comes of them, by one step each."""
        batch = self._standardise(replay.sample_demonstrations())
        metrics, _ = self.update_critic(batch)
        self._slow_critic.follow()
        with self._gathering(self.actor):
            distance = self._distance(batch)
        self._step(self.actor_optimiser, distance)
        self._slow_actor.follow()
        if self._average:
            self._average.follow()
        return metrics | {"clone_error": distance.item()}

    def _imitation(
        self, batch: Batch, action: Float[Tensor, "B A"], expected: Float[Tensor, "B"]
    ) -> tuple[Float[Tensor, ""], Float[Tensor, ""]]:
        """Return mean max(0, R - Q(s, mu(s))) |mu(s) - a|^2 / A, and its first factor's mean.

        After "self-imitation learning" (Oh et al. 2018), for a deterministic policy: one action's gradient does not
        show a way out of a place of rest that takes several actions in turn; what once led out of it does.

        Args:
            batch: with R and a.
            action: mu(s).
            expected: Q(s, mu(s)), without a gradient.
        """
        surplus = (self.learner.reward_scale * batch.bound - expected).clamp(min=0.0)
        return (surplus * (action - batch.action).square().mean(-1)).mean(), surplus.mean()

    def _distance(self, batch: Batch) -> Float[Tensor, ""]:
        """Return the mean squared distance of the actor's actions from those of a batch."""
        return (self.actor(batch.observation) - batch.action).square().mean()

    def _clone_weight(self) -> float:
        return self.learner.clone_weight * max(0.0, 1.0 - self.updates / self.learner.clone_updates)

    def _demonstrated(self, replay: Replay) -> Batch | None:
        """Return demonstrations for the actor not to go far from; none when their weight is 0."""
        if not replay.demonstrations or self._clone_weight() == 0:
            return None
        return self._standardise(replay.sample_demonstrations())

    def _networks(self) -> dict[str, nn.Module]:
        names = ("norm", "actor", "critic", "target_actor", "target_critic")
        average = {"average_actor": self._average.copy} if self._average else {}
        return {name: getattr(self, name) for name in names} | average

    def _optimisers(self) -> dict[str, torch.optim.Adam]:
        return {"actor_optimiser": self.actor_optimiser, "critic_optimiser": self.critic_optimiser}

    def _standardise(self, batch: Batch) -> Batch:
        """Return a batch on the networks' device, all but the places, with standardised observations."""
        device = self.device
        batch = Batch(batch.indices, *(tensor.to(device) for tensor in batch[1:]))
        both = self.norm(torch.stack([batch.observation, batch.next_observation]))
        observation, next_observation = both.unbind()
        return batch._replace(observation=observation, next_observation=next_observation)

    @contextlib.contextmanager
    def _gathering(self, network: nn.Module) -> Iterator[None]:
        """Let a network with batch normalisation use and gather the batch's own statistics; others have no such mode.

        To set a mode walks through all modules, which takes as long as a layer of a small network.
        """
        if self._has_batch_statistics:
            network.train()
        yield
        if self._has_batch_statistics:
            network.eval()

    def _step(self, optimiser: torch.optim.Optimizer, loss: Tensor) -> float:
        """Take one step down the loss with one network, no other receiving a gradient; return its length, unclipped."""
        parameters = optimiser.param_groups[0]["params"]
        for parameter, gradient in zip(parameters, torch.autograd.grad(loss, parameters), strict=True):
            parameter.grad = gradient
        norm = nn.utils.clip_grad_norm_(parameters, self.learner.max_grad_norm, foreach=True)
        optimiser.step()
        return norm.item()
