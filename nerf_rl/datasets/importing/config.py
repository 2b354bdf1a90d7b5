"""Keys of ``nerf-rl import``; importing this module loads nothing heavy."""

import dataclasses
from dataclasses import dataclass, field
from typing import Any

from nerf_rl.arguments.limits import require_most, require_seed
from nerf_rl.errors import UnknownNameError, UserError

NERFSTUDIO, LEROBOT = "nerfstudio", "lerobot"
FORMATS = ("auto", NERFSTUDIO, LEROBOT)
UNKNOWN, NOTHING = "unknown", "nothing"
USUAL_VALIDATION_FRACTION = 0.1
_HOW_NOT_WHAT = ("source", "out", "format", "resume", "overwrite")


@dataclass
class ImportConfig:
    """Keys of ``nerf-rl import``."""

    source: str
    """folder of nerfstudio scenes, each a moment in time, or of a LeRobotDataset; may be given without its key"""
    out: str
    """output folder"""
    format: str = "auto"
    """nerfstudio, lerobot, or auto: by what the folder holds"""
    encoder: list[str] = field(default_factory=list)
    """cameras that feed the encoder; with none, those that the source names, else all that stand still"""
    test: list[str] = field(default_factory=list)
    """cameras that nothing is trained on; with none, those that the source names"""
    scale: float = 1.0
    """metres in a unit of the source's positions and depth"""
    shrink: int = 1
    """pictures become so many times smaller in both directions"""
    empty_depth: str = UNKNOWN
    """what depth 0 means in nerfstudio's scenes: unknown (no ray is drawn there) or nothing (nothing was hit)"""
    far: float = 1000.0
    """depth that stands for nothing having been hit; what is farther counts as nothing [m]"""
    validation_fraction: float | None = None
    """share of episodes held out for validation; null: those that the source names, else 0.1"""
    episodes_per_shard: int = 50
    """episodes in a shard file; a scene that does not say otherwise is an episode"""
    seed: int = 0
    """seed of the choice of held-out episodes"""
    resume: bool = False
    """keep the finished shards of an interrupted import of the same source with the same keys"""
    overwrite: bool = False
    """replace an existing dataset"""

    def __post_init__(self) -> None:
        if self.format not in FORMATS:
            raise UnknownNameError("format", self.format, FORMATS)
        if self.empty_depth not in (UNKNOWN, NOTHING):
            raise UnknownNameError("empty_depth", self.empty_depth, (UNKNOWN, NOTHING))
        for name in ("shrink", "episodes_per_shard"):
            if getattr(self, name) < 1:
                raise UserError(f"--{name} must be at least 1, got {getattr(self, name)}")
        for name in ("scale", "far"):
            if not getattr(self, name) > 0:
                raise UserError(f"--{name} must be positive, got {getattr(self, name)}")
        require_most(self, scale=10**6, far=10**6, shrink=1024)
        require_seed(self.seed)
        both = sorted({*self.encoder} & {*self.test})
        if both:
            raise UserError(f"--encoder and --test both name {', '.join(both)}")
        if self.validation_fraction is not None and not 0 <= self.validation_fraction < 1:
            raise UserError(f"--validation_fraction must be in [0, 1), got {self.validation_fraction}")

    def content(self) -> dict[str, Any]:
        """Return the keys that decide the content of the dataset, beside its source."""
        return {key: value for key, value in dataclasses.asdict(self).items() if key not in _HOW_NOT_WHAT}
