"""What an evaluation is made of; importing this module loads nothing heavy."""

from dataclasses import dataclass

from nerf_rl.arguments.limits import require_most, require_seed
from nerf_rl.errors import UserError
from nerf_rl.machine.devices import check_device_name


@dataclass
class EvaluateConfig:
    """Keys of ``nerf-rl evaluate``."""

    run: str
    """run folder of train-rl, or hf://USER/NAME[@REVISION] of an agent (extra hub)"""
    out: str
    """output folder"""
    encoder: str = ""
    """where the encoder is now, if it has moved since training: a folder, or hf://USER/NAME"""
    episodes: int = 20
    """episodes to count"""
    envs: int = 2
    """environments, each in a process of its own"""
    seed: int = 1
    """seed of the episodes; training's own evaluations use 0"""
    device: str = "cpu"
    """where to run the policy, and each environment's encoder: cpu, cuda, cuda:1 or auto"""
    video: bool = False
    """also write an mp4 of a few episodes"""
    video_episodes: int = 3
    """episodes in the video"""
    video_size: int = 256
    """height of the video [pixels]"""
    overwrite: bool = False
    """replace an existing output folder"""

    def __post_init__(self) -> None:
        for name in ("episodes", "envs", "video_episodes"):
            if getattr(self, name) < 1:
                raise UserError(f"--{name} must be at least 1, got {getattr(self, name)}")
        check_device_name(self.device)
        require_seed(self.seed)
        require_most(self, episodes=10**6, envs=1024, video_size=4096)
        if self.video_size < 32 or self.video_size % 16:
            raise UserError(f"--video_size must be a multiple of 16 and at least 32, got {self.video_size}")
