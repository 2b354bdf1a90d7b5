"""Keys of the baselines; importing this module loads nothing heavy."""

from dataclasses import dataclass, field
from typing import Annotated, Literal

from nerf_rl.arguments.limits import Count, Limits, NotNegative, Positive, Share, check_values
from nerf_rl.errors import UserError


@dataclass
class PPOConfig:
    """Proximal policy optimisation by Stable-Baselines3, in the words of its RL Zoo; defaults are SB3's."""

    n_steps: Annotated[int, Limits(least=2)] = 2048
    """agent steps in each environment before each round of updates"""
    batch_size: Annotated[int, Limits(least=2)] = 64
    """steps in an update"""
    n_epochs: Count = 10
    """passes over the collected steps"""
    gamma: Share = 0.99
    """discount of one agent step"""
    gae_lambda: Share = 0.95
    """bias against variance of the advantages (Schulman et al. 2016)"""
    learning_rate: Positive = 3e-4
    """Adam's"""
    clip_range: Positive = 0.2
    """ratio of probabilities beyond which an update is cut off"""
    ent_coef: NotNegative = 0.0
    """weight of the entropy bonus"""
    vf_coef: NotNegative = 0.5
    """weight of the value loss"""
    max_grad_norm: Positive = 0.5
    """gradients longer than this are shortened"""
    log_std_init: Annotated[float, Limits(least=-20, most=20)] = 0.0
    """logarithm of the actions' first standard deviation"""
    hidden: list[Count] = field(default_factory=lambda: [64, 64])
    """widths of the hidden layers of policy and value"""
    activation: Literal["tanh", "relu"] = "tanh"
    """tanh or relu"""
    normalise: bool = True
    """standardise observations and scale rewards by running statistics (SB3's VecNormalize)"""

    def __post_init__(self) -> None:
        check_values(self, "ppo.")
        if not self.hidden:
            raise UserError("--ppo.hidden must name the width of a layer or more")
