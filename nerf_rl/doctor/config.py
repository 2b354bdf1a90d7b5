"""Keys of ``nerf-rl doctor``; importing this module loads nothing heavy."""

from dataclasses import dataclass

from nerf_rl.arguments.limits import Positive, check_values
from nerf_rl.errors import UserError


@dataclass
class DoctorConfig:
    """Keys of ``nerf-rl doctor``."""

    folder: str = "."
    """where datasets and runs will be written, to look at its free space"""
    json: str = ""
    """write the findings to this .json file as well"""
    timeout: Positive = 300.0
    """seconds after which a probe counts as hanging"""

    def __post_init__(self) -> None:
        check_values(self)
        if self.json and not self.json.endswith(".json"):
            raise UserError(f"--json must be a .json file, got {self.json}")
