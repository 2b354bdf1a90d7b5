"""The trained policy as a pair of files: ``policy.safetensors`` (weights) and ``policy.json`` (all else)."""

from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import torch
from jaxtyping import Float
from numpy import ndarray
from safetensors.torch import load_file
from torch import nn

from nerf_rl.rl.artefact import POLICY_DESCRIPTION, POLICY_WEIGHTS, check_policy
from nerf_rl.rl.config import NetworkConfig
from nerf_rl.rl.envs import EnvSpec
from nerf_rl.rl.networks import Actor
from nerf_rl.rl.normalisation import RunningNorm
from nerf_rl.runs import package_versions, write_json
from nerf_rl.tensor_files import write_tensors

_VERSION = 1


@dataclass
class Policy:
    """A deterministic policy and what is needed to act with it."""

    actor: nn.Sequential
    """standardisation and actor"""
    spec: EnvSpec
    network: NetworkConfig
    observation_size: int
    action_size: int
    proprio_names: list[str]
    encoder_digest: str | None
    env_steps: int

    @torch.no_grad()
    def act(self, observation: Float[ndarray, "E O"]) -> Float[ndarray, "E A"]:
        """Return actions in [-1, 1]."""
        return self.actor(torch.from_numpy(observation)).numpy()

    def save(self, folder: Path) -> None:
        """Write both files, each whole or not at all."""
        write_tensors(folder / POLICY_WEIGHTS, self.actor.state_dict())
        content: dict[str, Any] = {
            "version": _VERSION,
            "env": asdict(self.spec),
            "network": asdict(self.network),
            "observation_size": self.observation_size,
            "action_size": self.action_size,
            "proprio_names": self.proprio_names,
            "encoder_digest": self.encoder_digest,
            "env_steps": self.env_steps,
            "packages": package_versions(),
        }
        write_json(folder / POLICY_DESCRIPTION, content)

    @staticmethod
    def load(run: Path, encoder: str = "") -> "Policy":
        """Read a policy.

        Args:
            run: a run folder of train-rl.
            encoder: where its encoder is now, if it has moved.

        Raises:
            UserError: no policy there, or the encoder is not the one that it was trained with.
        """
        content = check_policy(run, encoder)
        network = NetworkConfig(**content["network"])
        actor = _network(content["observation_size"], content["action_size"], network)
        actor.load_state_dict(load_file(run / POLICY_WEIGHTS))
        names = ("observation_size", "action_size", "proprio_names", "encoder_digest", "env_steps")
        kept = {name: content[name] for name in names}
        return Policy(actor.eval().requires_grad_(False), EnvSpec(**content["env"]), network, **kept)


def _network(observation_size: int, action_size: int, config: NetworkConfig) -> nn.Sequential:
    norm = RunningNorm(observation_size) if config.standardise else nn.Identity()
    return nn.Sequential(norm, Actor(observation_size, action_size, config))
