"""What an evaluation is made of; importing this module loads nothing heavy."""

from dataclasses import dataclass
from typing import Annotated

from nerf_rl.arguments.limits import Count, Limits, Processes, Seed, check_values
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
    episodes: Annotated[int, Limits(least=1, most=10**6)] = 20
    """episodes to count"""
    envs: Processes = 2
    """environments, each in a process of its own"""
    seed: Seed = 1
    """seed of the episodes; training's own evaluations use 0"""
    device: str = "cpu"
    """where to run the policy, and each environment's encoder: cpu, cuda, cuda:1 or auto"""
    video: bool = False
    """also write an mp4 of a few episodes"""
    video_episodes: Count = 3
    """episodes in the video"""
    video_size: Annotated[int, Limits(least=32, most=4096)] = 256
    """height of the video [pixels]"""
    overwrite: bool = False
    """replace an existing output folder"""

    def __post_init__(self) -> None:
        check_values(self)
        check_device_name(self.device)
        if self.video_size % 16:
            raise UserError(f"--video_size must be a multiple of 16, got {self.video_size}")
