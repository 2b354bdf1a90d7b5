"""What to check of a dataset."""

from dataclasses import dataclass

from nerf_rl.arguments.limits import Processes, check_values


@dataclass
class CheckConfig:
    """Keys of ``nerf-rl check``."""

    folder: str
    """folder of the dataset"""
    repair: bool = False
    """render damaged and missing shards again, from the manifest's configuration"""
    workers: Processes = 2
    """render processes of a repair"""

    def __post_init__(self) -> None:
        check_values(self)
