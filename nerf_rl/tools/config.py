"""Keys of the commands that show what the other stages made."""

from dataclasses import dataclass

from nerf_rl.errors import UserError


@dataclass
class ReportConfig:
    """Keys of ``nerf-rl report``."""

    data: str
    """dataset folder"""
    encoder: str
    """run folder of pretrain"""
    agent: str
    """run folder of train-rl with that encoder"""
    out: str
    """the page to write, an .html file"""
    episodes: int = 2
    """episodes in the clip"""
    seed: int = 1
    """seed of those episodes"""
    overwrite: bool = False
    """replace an existing page"""

    def __post_init__(self) -> None:
        if not self.out.endswith(".html"):
            raise UserError(f"--out must be an .html file, got {self.out}")
        if self.episodes < 1 or self.seed < 0:
            raise UserError("--episodes must be at least 1 and --seed must not be negative")
