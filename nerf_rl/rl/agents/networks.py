"""Actor and critic of DDPG, the action joining the critic after its first layer; and the plain actor of baselines."""

import itertools
from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor, nn

from nerf_rl.rl.config import NetworkConfig


def _layer(inputs: int, width: int, normalisation: str) -> list[nn.Module]:
    norms: dict[str, type[nn.Module]] = {"layer": nn.LayerNorm, "batch": nn.BatchNorm1d}
    norm = norms[normalisation](width) if normalisation in norms else nn.Identity()
    return [nn.Linear(inputs, width), norm, nn.ReLU()]


def _initialise(module: nn.Module, last: nn.Linear) -> None:
    """Xavier weights and zero biases (Glorot and Bengio 2010); the last layer 100 times smaller.

    A small last layer starts the actor at the centre of tanh and the critic at zero.
    """
    for layer in module.modules():
        if isinstance(layer, nn.Linear):
            nn.init.xavier_uniform_(layer.weight, gain=0.01 if layer is last else 1.0)
            nn.init.zeros_(layer.bias)


class Actor(nn.Module):
    """Deterministic policy: observation [B, O] to action [B, A] in (-1, 1)."""

    def __init__(self, observation_size: int, action_size: int, config: NetworkConfig):
        super().__init__()
        (first, second), kind = config.hidden, config.normalisation
        self.trunk = nn.Sequential(*_layer(observation_size, first, kind), *_layer(first, second, kind))
        self.head = nn.Linear(second, action_size)
        _initialise(self, self.head)

    def pre_tanh(self, observation: Float[Tensor, "B O"]) -> Float[Tensor, "B A"]:
        """Return the activation before the tanh that bounds the action."""
        return self.head(self.trunk(observation))

    def forward(self, observation: Float[Tensor, "B O"]) -> Float[Tensor, "B A"]:
        """Return the action."""
        return torch.tanh(self.pre_tanh(observation))


class Critic(nn.Module):
    """Action value: observation [B, O] and action [B, A] to the expected discounted return [B]."""

    def __init__(self, observation_size: int, action_size: int, config: NetworkConfig):
        super().__init__()
        (first, second), kind = config.hidden, config.normalisation
        self.observe = nn.Sequential(*_layer(observation_size, first, kind))
        self.join = nn.Sequential(*_layer(first + action_size, second, kind))
        self.head = nn.Linear(second, 1)
        _initialise(self, self.head)

    def forward(self, observation: Float[Tensor, "B O"], action: Float[Tensor, "B A"]) -> Float[Tensor, "B"]:
        """Return the value, without a trailing dimension, so that it meets weights [B] element by element."""
        hidden = self.join(torch.cat([self.observe(observation), action], dim=-1))
        return self.head(hidden).squeeze(-1)


@dataclass(frozen=True)
class LayeredConfig:
    """A plain multi-layer actor, as the baselines export it."""

    hidden: list[int]
    """widths of the hidden layers"""
    activation: str
    """tanh or relu, after each hidden layer"""
    bound: str
    """what keeps actions in [-1, 1]: tanh or clip"""
    observation_limit: float | None
    """magnitude beyond which standardised observations are cut off"""


class LayeredActor(nn.Module):
    """Deterministic policy: standardised observation [B, O] to action [B, A] in [-1, 1]."""

    def __init__(self, observation_size: int, action_size: int, config: LayeredConfig):
        super().__init__()
        limit, sizes = config.observation_limit, [observation_size, *config.hidden]
        activation = {"tanh": nn.Tanh, "relu": nn.ReLU}[config.activation]
        self.layers = nn.Sequential(nn.Identity() if limit is None else nn.Hardtanh(-limit, limit))
        for before, after in itertools.pairwise(sizes):
            self.layers.extend([nn.Linear(before, after), activation()])
        self.layers.append(nn.Linear(sizes[-1], action_size))
        self.layers.append(nn.Tanh() if config.bound == "tanh" else nn.Hardtanh())

    def forward(self, observation: Float[Tensor, "B O"]) -> Float[Tensor, "B A"]:
        """Return the action."""
        return self.layers(observation)
