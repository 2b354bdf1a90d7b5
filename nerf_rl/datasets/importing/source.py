"""What every source of posed pictures is to an import, whatever its format."""

from abc import ABC, abstractmethod
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Float32, UInt8
from numpy import ndarray

BACKGROUND: dict[str, Any] = {"name": "background", "colour": [128, 128, 128]}
"""the only class of a source without labels"""


class SourceEpisode(NamedTuple):
    """Neighbouring frames of a source, which are trained on or held out together."""

    frames: int
    split: str | None
    """train or validation, if the source says so"""


@dataclass(frozen=True)
class SourceFrame:
    """What V cameras saw at one moment."""

    place: str
    """where it comes from, for messages"""
    step: int
    """environment steps since the episode's reset"""
    rgb: UInt8[ndarray, "V H W 3"]
    depth: Float32[ndarray, "V H W"] | None
    """planar [m], infinite where nothing was hit"""
    labels: UInt8[ndarray, "V H W"] | None
    """class ids"""
    valid: Bool[ndarray, "V H W"] | None = None
    """which pixels count; None if all do"""
    camera_from_world: Float[ndarray, "V 4 4"] | None = None
    """of a source whose cameras move"""
    columns: Mapping[str, ndarray] = field(default_factory=dict)
    """values of the columns of ``proprio``, ``privileged`` and ``action``"""
    reward: float = 0.0
    success: bool = False


class Source(ABC):
    """Posed pictures. Everything here is known before the first picture is read."""

    format: str
    digest: str
    """tells this source from others"""
    camera_names: list[str]
    roles: dict[str, str]
    """of the cameras of which the source tells it: encoder, supervision or test"""
    intrinsics: Float[ndarray, "V 3 3"]
    """K of a picture as the source has it [pixels]"""
    height: int
    """of a picture as the source has it [pixels]"""
    width: int
    """of a picture as the source has it [pixels]"""
    camera_from_world: Float[ndarray, "V 4 4"] | None
    """of cameras that all stand still; None if one moves"""
    still: set[str]
    """names of the cameras that stand still"""
    classes: list[dict[str, Any]]
    """``name`` and ``colour`` of each class, by id"""
    columns: dict[str, list[str]]
    """names of the columns of ``proprio``, ``privileged`` and ``action``"""
    absent: tuple[str, ...]
    """what the source lacks, of ``depth``, ``labels`` and ``state``"""
    has_invalid: bool
    """whether some pixels may not count"""
    episodes: list[SourceEpisode]

    @abstractmethod
    def frames(self, episode: int) -> Iterator[SourceFrame]:
        """Yield the frames of an episode, in order.

        Raises:
            SourceError: a file is not what the source says.
        """


NO_COLUMNS: dict[str, list[str]] = {"proprio": [], "privileged": [], "action": []}


def no_values() -> dict[str, ndarray]:
    """Return the values of no columns."""
    return {group: np.zeros(0, np.float32) for group in NO_COLUMNS}
