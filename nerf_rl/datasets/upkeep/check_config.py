"""What to check of a dataset."""

from dataclasses import dataclass

from nerf_rl.errors import UserError


@dataclass
class CheckConfig:
    """Keys of ``nerf-rl check``."""

    folder: str
    """folder of the dataset"""
    repair: bool = False
    """render damaged and missing shards again, from the manifest's configuration"""
    workers: int = 2
    """render processes of a repair"""

    def __post_init__(self) -> None:
        if self.workers < 1:
            raise UserError(f"--workers must be at least 1, got {self.workers}")
