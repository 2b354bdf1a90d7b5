"""Keys of ``nerf-rl report``; importing this module loads nothing heavy."""

from dataclasses import dataclass

from nerf_rl.arguments.limits import Count, Seed, check_values
from nerf_rl.errors import UserError


@dataclass
class ReportConfig:
    """Keys of ``nerf-rl report``."""

    agent: str
    """run folder of train-rl"""
    out: str
    """the page to write, an .html file"""
    data: str = ""
    """dataset folder; by default the one that the encoder was trained on, if it is still there"""
    encoder: str = ""
    """run folder of pretrain; by default the agent's encoder, if it has one"""
    episodes: Count = 2
    """episodes in the clip"""
    seed: Seed = 1
    """seed of those episodes"""
    overwrite: bool = False
    """replace an existing page"""

    def __post_init__(self) -> None:
        check_values(self)
        if not self.out.endswith(".html"):
            raise UserError(f"--out must end in .html, got {self.out}")
