"""The trained policy as a pair of files: ``policy.safetensors`` (weights) and ``policy.json`` (all else)."""

from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import torch
from jaxtyping import Float
from numpy import ndarray
from torch import nn

from nerf_rl.errors import FailureError, UserError
from nerf_rl.files.json_files import write_json
from nerf_rl.files.tensor_files import filled, read_tensors, write_tensors
from nerf_rl.files.versions import package_versions
from nerf_rl.rl.agents.networks import Actor, LayeredActor, LayeredConfig
from nerf_rl.rl.agents.normalisation import RunningNorm
from nerf_rl.rl.agents.policy_file import POLICY_DESCRIPTION, POLICY_VERSION, POLICY_WEIGHTS, check_policy
from nerf_rl.rl.config import NetworkConfig
from nerf_rl.rl.environments.make import EnvSpec, spec_from_json

_KINDS: dict[type, str] = {NetworkConfig: "ddpg", LayeredConfig: "layered"}


@dataclass
class Policy:
    """A deterministic policy and what is needed to act with it."""

    actor: nn.Sequential
    """standardisation and actor"""
    spec: EnvSpec
    network: NetworkConfig | LayeredConfig
    observation_size: int
    action_size: int
    proprio_names: list[str]
    encoder_digest: str | None
    env_steps: int
    demonstrations: int = 0
    """that its training began with"""
    to_end: bool = False
    """whether evaluated episodes go on after a success"""

    def require_spaces(self, observation: gymnasium.Space, action: gymnasium.Space) -> None:
        """Raise UserError if an environment with these spaces is not the one that the policy was trained in."""
        found, trained = (observation.shape, action.shape), ((self.observation_size,), (self.action_size,))
        if found != trained:
            raise UserError(
                f"{self.spec.scene} has changed since the policy was trained in it: it has observations of {found[0]} "
                f"and actions of {found[1]}, the policy {trained[0]} and {trained[1]}; train again"
            )

    def act(self, observation: Float[ndarray, "E O"]) -> Float[ndarray, "E A"]:
        """Return actions in [-1, 1].

        Raises:
            FailureError: they are not numbers, for the weights or the observation are out of all proportion.
        """
        actions = act(self.actor, observation)
        if np.isnan(actions).any():
            raise FailureError("the policy gives actions that are not numbers; train it, or its encoder, again")
        return actions

    def save(self, folder: Path) -> None:
        """Write both files, each whole or not at all."""
        write_tensors(folder / POLICY_WEIGHTS, self.actor.state_dict())
        content: dict[str, Any] = {
            "version": POLICY_VERSION,
            "env": asdict(self.spec),
            "network": {"kind": _KINDS[type(self.network)], **asdict(self.network)},
            "observation_size": self.observation_size,
            "action_size": self.action_size,
            "proprio_names": self.proprio_names,
            "encoder_digest": self.encoder_digest,
            "env_steps": self.env_steps,
            "packages": package_versions(),
        }
        if self.demonstrations:
            content["demonstrations"] = self.demonstrations
        if self.to_end:
            content["to_end"] = True
        write_json(folder / POLICY_DESCRIPTION, content)

    @staticmethod
    def load(run: Path, encoder: str = "", device: torch.device | str = "cpu") -> "Policy":
        """Read a policy.

        Args:
            run: a run folder of train-rl.
            encoder: where its encoder is now, if it has moved.
            device: to act on.

        Raises:
            UserError: no policy there, or the encoder is not the one that it was trained with.
        """
        content = check_policy(run, encoder)
        description = content["network"]
        kinds = {kind: network for network, kind in _KINDS.items()}
        network = kinds[description.pop("kind")](**description)
        weights = run / POLICY_WEIGHTS
        sizes = (content["observation_size"], content["action_size"])
        actor = filled(lambda: make_actor(*sizes, network), read_tensors(weights), weights)
        names = {field.name for field in fields(Policy)} - {"actor", "spec", "network"}
        kept = {name: content[name] for name in names & content.keys()}
        return Policy(actor.eval().requires_grad_(False).to(device), spec_from_json(content["env"]), network, **kept)


@torch.no_grad()
def act(network: nn.Sequential, observation: Float[ndarray, "E O"]) -> Float[ndarray, "E A"]:
    """Return the actions of standardisation and actor, computed where they are."""
    device = next(network.parameters()).device
    return network(torch.from_numpy(observation).to(device)).cpu().numpy()


def make_actor(observation_size: int, action_size: int, network: NetworkConfig | LayeredConfig) -> nn.Sequential:
    """Return standardisation and actor, untrained."""
    if isinstance(network, LayeredConfig):
        return nn.Sequential(
            RunningNorm(observation_size, floor=0.0), LayeredActor(observation_size, action_size, network)
        )
    norm = RunningNorm(observation_size) if network.standardise else nn.Identity()
    return nn.Sequential(norm, Actor(observation_size, action_size, network))
