"""What of a frame is exported: surfaces that were hit, within reach, of the classes asked for."""

import sys
from collections.abc import Collection
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float32
from numpy import ndarray

from nerf_rl.datasets.storage.frames import Frame
from nerf_rl.datasets.storage.point_cloud import PointCloud, fuse_views
from nerf_rl.datasets.storage.reader import MultiViewDataset

_FAR = 0.999  # of the far plane's depth: what is farther is background, up to the depth buffer's rounding


@dataclass(frozen=True)
class Seen:
    """A frame, and what of it counts."""

    frame: Frame
    reach: float
    """planar depth beyond which nothing counts [m]"""
    classes: tuple[int, ...]
    """ids of the classes that count"""

    def surface(self) -> Bool[ndarray, "V H W"]:
        """Tell which pixels show a surface within reach, of any class."""
        return self.frame.depth < self.reach

    def kept(self) -> Bool[ndarray, "V H W"]:
        """Tell which pixels count, and show a class that does, whether within reach or not."""
        kept = np.isin(self.frame.semantic, self.classes)
        return kept if self.frame.valid is None else kept & self.frame.valid

    def depth(self) -> Float32[ndarray, "V H W"]:
        """Return planar depth [m], 0 where nothing counts."""
        return np.where(self.surface() & self.kept(), self.frame.depth, np.float32(0))

    def cloud(self) -> PointCloud:
        """Return the coloured points of all views."""
        no_palette = np.zeros((1, 3), np.uint8)
        return fuse_views(self.frame, "RGB", no_palette, (0.0, 1.0), self.classes, self.reach, most=sys.maxsize)


def seen_in_frame(dataset: MultiViewDataset, frame: Frame, exclude: Collection[str], reach: float) -> Seen:
    """Return what counts of a frame.

    Args:
        dataset: the frame's.
        frame: to export.
        exclude: names of the classes that do not count.
        reach: planar depth beyond which nothing counts [m]; 0 for whatever was hit.
    """
    hit = farthest_hit(dataset)
    classes = tuple(i for i, name in enumerate(dataset.class_names) if name not in exclude)
    return Seen(frame, min(reach, hit) if reach > 0 else hit, classes)


def farthest_hit(dataset: MultiViewDataset) -> float:
    """Return the planar depth from which on nothing was hit [m]."""
    return _FAR * float(dataset.manifest["far"])
