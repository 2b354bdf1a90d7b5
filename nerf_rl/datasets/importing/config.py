"""Keys of ``nerf-rl import``; importing this module loads nothing heavy."""

import dataclasses
from dataclasses import dataclass, field
from typing import Annotated, Any, Final, Literal

from nerf_rl.arguments.limits import Count, Limits, Seed, ShareBelowOne, check_values
from nerf_rl.errors import UserError

NERFSTUDIO, LEROBOT = "nerfstudio", "lerobot"
UNKNOWN: Final = "unknown"
NOTHING: Final = "nothing"
USUAL_VALIDATION_FRACTION = 0.1
_HOW_NOT_WHAT = ("source", "out", "format", "resume", "overwrite")


@dataclass
class ImportConfig:
    """Keys of ``nerf-rl import``."""

    source: str
    """folder of nerfstudio scenes, each a moment in time, or of a LeRobotDataset; may be given without its key"""
    out: str
    """output folder"""
    format: Literal["auto", "nerfstudio", "lerobot"] = "auto"
    """nerfstudio, lerobot, or auto: by what the folder holds"""
    encoder: list[str] = field(default_factory=list)
    """cameras that feed the encoder; with none, those that the source names, else all that stand still"""
    test: list[str] = field(default_factory=list)
    """cameras that nothing is trained on; with none, those that the source names"""
    scale: Annotated[float, Limits(above=0, most=10**6)] = 1.0
    """metres in a unit of the source's positions and depth"""
    shrink: Annotated[int, Limits(least=1, most=1024)] = 1
    """pictures become so many times smaller in both directions"""
    empty_depth: Literal["unknown", "nothing"] = UNKNOWN
    """what depth 0 means in nerfstudio's scenes: unknown (no ray is drawn there) or nothing (nothing was hit)"""
    far: Annotated[float, Limits(above=0, most=10**6)] = 1000.0
    """depth that stands for nothing having been hit; what is farther counts as nothing [m]"""
    validation_fraction: ShareBelowOne | None = None
    """share of episodes held out for validation; null: those that the source names, else 0.1"""
    episodes_per_shard: Count = 50
    """episodes in a shard file; a scene that does not say otherwise is an episode"""
    seed: Seed = 0
    """seed of the choice of held-out episodes"""
    resume: bool = False
    """keep the finished shards of an interrupted import of the same source with the same keys"""
    overwrite: bool = False
    """replace an existing dataset"""

    def __post_init__(self) -> None:
        check_values(self)
        both = sorted({*self.encoder} & {*self.test})
        if both:
            raise UserError(f"--encoder and --test both name {', '.join(both)}")

    def content(self) -> dict[str, Any]:
        """Return the keys that decide the content of the dataset, beside its source."""
        return {key: value for key, value in dataclasses.asdict(self).items() if key not in _HOW_NOT_WHAT}
