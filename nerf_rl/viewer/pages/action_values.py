"""Action values of a trained agent, from its last checkpoint."""

from pathlib import Path

import torch
from jaxtyping import Float
from numpy import ndarray
from torch import nn

from nerf_rl.files.tensor_files import filled, strip_prefix
from nerf_rl.rl.agents.networks import Critic
from nerf_rl.rl.agents.normalisation import RunningNorm
from nerf_rl.rl.agents.policy import Policy
from nerf_rl.rl.config import NetworkConfig
from nerf_rl.rl.training.checkpoint import last_checkpoint, load_checkpoint


class ActionValues:
    """Q(s, a) as the agent's critic has it, in scaled rewards.

    Args:
        norm: standardises observations.
        critic: of the agent.
    """

    def __init__(self, norm: nn.Module, critic: Critic):
        self._norm, self._critic = norm.eval(), critic.eval()

    @torch.inference_mode()
    def __call__(self, observations: Float[ndarray, "N O"], actions: Float[ndarray, "N A"]) -> Float[ndarray, "N"]:
        """Return the value of each action in its state."""
        device = next(self._critic.parameters()).device
        observed, acted = (torch.from_numpy(array).to(device) for array in (observations, actions))
        return self._critic(self._norm(observed), acted).cpu().numpy()

    @staticmethod
    def load(run: Path, policy: Policy) -> "ActionValues | None":
        """Read the critic of a run; None if the run has no checkpoint with one, as baselines do not."""
        folder, network = last_checkpoint(run), policy.network
        if folder is None or not isinstance(network, NetworkConfig):
            return None
        checkpoint, _ = load_checkpoint(folder)
        tensors = strip_prefix(checkpoint, "agent")
        weights = strip_prefix(tensors, "critic")
        if not weights:
            return None
        sizes = (policy.observation_size, policy.action_size)
        critic = filled(lambda: Critic(*sizes, network), weights, folder)
        norm: nn.Module = nn.Identity()
        if network.standardise:
            norm = filled(lambda: RunningNorm(policy.observation_size), strip_prefix(tensors, "norm"), folder)
        return ActionValues(norm, critic)
