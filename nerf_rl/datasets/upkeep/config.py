"""What to check of a dataset, and which parts to put together."""

from dataclasses import dataclass

from nerf_rl.arguments.limits import Processes, check_values
from nerf_rl.errors import UserError


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


@dataclass
class MergeConfig:
    """Keys of ``nerf-rl merge``."""

    parts: list[str]
    """folders that gen-dataset --shard I/N wrote to"""
    out: str = ""
    """output folder (that of the parts if they share one: no shard is copied)"""
    resume: bool = False
    """keep the shards that an interrupted merge has copied"""
    overwrite: bool = False
    """replace an existing dataset"""

    def __post_init__(self) -> None:
        if not self.parts:
            raise UserError("--parts is empty; name the folders that gen-dataset --shard I/N wrote to")
        if not self.out and len(self.parts) != 1:
            raise UserError(f"--out is needed to put {len(self.parts)} folders together")
