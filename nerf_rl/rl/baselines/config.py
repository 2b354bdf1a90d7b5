"""Keys of the baselines; importing this module loads nothing heavy."""

from dataclasses import dataclass, field

from nerf_rl.errors import UnknownNameError, UserError


@dataclass
class PPOConfig:
    """Proximal policy optimisation by Stable-Baselines3, in the words of its RL Zoo; defaults are SB3's."""

    n_steps: int = 2048
    """agent steps in each environment before each round of updates"""
    batch_size: int = 64
    """steps in an update"""
    n_epochs: int = 10
    """passes over the collected steps"""
    gamma: float = 0.99
    """discount of one agent step"""
    gae_lambda: float = 0.95
    """bias against variance of the advantages (Schulman et al. 2016)"""
    learning_rate: float = 3e-4
    """Adam's"""
    clip_range: float = 0.2
    """ratio of probabilities beyond which an update is cut off"""
    ent_coef: float = 0.0
    """weight of the entropy bonus"""
    vf_coef: float = 0.5
    """weight of the value loss"""
    max_grad_norm: float = 0.5
    """gradients longer than this are shortened"""
    log_std_init: float = 0.0
    """logarithm of the actions' first standard deviation"""
    hidden: list[int] = field(default_factory=lambda: [64, 64])
    """widths of the hidden layers of policy and value"""
    activation: str = "tanh"
    """tanh or relu"""
    normalise: bool = True
    """standardise observations and scale rewards by running statistics (SB3's VecNormalize)"""

    def __post_init__(self) -> None:
        if self.activation not in ("tanh", "relu"):
            raise UnknownNameError("activation", self.activation, ("tanh", "relu"))
        if not self.hidden or min(self.hidden) < 1:
            raise UserError(f"--ppo.hidden needs positive widths, got {self.hidden}")
        for name, least in (("n_steps", 2), ("batch_size", 2), ("n_epochs", 1)):
            if getattr(self, name) < least:
                raise UserError(f"--ppo.{name} must be at least {least}, got {getattr(self, name)}")
        for name in ("gamma", "gae_lambda"):
            if not 0 <= getattr(self, name) <= 1:
                raise UserError(f"--ppo.{name} must be in [0, 1], got {getattr(self, name)}")
        for name in ("learning_rate", "clip_range", "max_grad_norm"):
            if getattr(self, name) <= 0:
                raise UserError(f"--ppo.{name} must be positive, got {getattr(self, name)}")
        for name in ("ent_coef", "vf_coef"):
            if getattr(self, name) < 0:
                raise UserError(f"--ppo.{name} must not be negative, got {getattr(self, name)}")
