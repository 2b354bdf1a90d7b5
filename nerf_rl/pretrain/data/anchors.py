"""Where things are: the middles of what cameras see of each class, which frames of the radiance field follow.

A photometric loss has no slope towards a small thing that it does not overlap, so a field may learn all but the one
thing that matters. A middle has a slope from anywhere. It takes labels and depth, and nothing of the simulator's state.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int, UInt8
from numpy import ndarray

from nerf_rl.cameras.geometry import camera_position
from nerf_rl.datasets.storage.point_cloud import unproject
from nerf_rl.datasets.storage.reader import MultiViewDataset

BACKGROUND = 0
"""class id of what nothing follows"""
_LEAST_PIXELS = 6  # of a class in a frame: the middle of fewer is noise
_LEAST_SEEN = 0.02  # share of frames that show a class which is followed
_LEAST_SPREAD = 0.002  # of its middle, as a share of how far off things are: a class that moves less stays where it is


class Middles(NamedTuple):
    """Where C classes are in B frames."""

    place: Float[ndarray, "B C 3"]
    """mean of the surface points that cameras see [m]; zero where there are too few"""
    seen: Bool[ndarray, "B C"]
    """whether there are enough"""


class Anchors(NamedTuple):
    """The classes that move, of which each is followed by a frame."""

    classes: tuple[int, ...]
    """their ids"""
    mean: Float[ndarray, "A 3"]
    """of their middles over frames [m]"""
    spread: Float[ndarray, "A"]
    """root mean square distance of their middles from there [m]"""
    size: Float[ndarray, "A"]
    """root mean square distance of the points that cameras see of them from their middle [m]"""
    share: Float[ndarray, "A"]
    """of the pixels that show them"""
    seldom: tuple[int, ...] = ()
    """ids of classes that hardly any frame shows, of which nobody knows whether they move"""

    def describe(self, class_names: Sequence[str]) -> str:
        """Return which classes are followed, and which cannot be, in a line."""
        followed, seldom = (", ".join(class_names[c] for c in chosen) for chosen in (self.classes, self.seldom))
        told = f"following what moves: {followed or 'nothing'}"
        return f"{told}; hardly any picture shows {seldom}, so z is not told where that is" if seldom else told

    @classmethod
    def of_nothing(cls) -> "Anchors":
        """Return those of a dataset that nothing is followed in."""
        return cls((), np.zeros((0, 3)), np.zeros(0), np.zeros(0), np.zeros(0))


def visible_middles(
    depth: Float[ndarray, "B V H W"],
    semantic: UInt8[ndarray, "B V H W"],
    intrinsics: Float[ndarray, "V 3 3"],
    camera_from_world: Float[ndarray, "B V 4 4"],
    classes: int,
) -> Middles:
    """Return the middle of what some cameras see of each class, all their pixels together.

    Args:
        depth: planar [m].
        semantic: class ids.
        intrinsics, camera_from_world: of the cameras.
        classes: number of classes.
    """
    frames, views, height, width = depth.shape
    x = (np.arange(width) + 0.5 - intrinsics[:, :1, 2]) / intrinsics[:, :1, 0]
    y = (np.arange(height) + 0.5 - intrinsics[:, 1:2, 2]) / intrinsics[:, 1:2, 1]
    rays = np.ones((views, height, width, 3), np.float32)
    rays[..., 0], rays[..., 1] = x[:, None], y[:, :, None]
    ids = np.arange(classes, dtype=np.uint8)[:, None]
    count = np.zeros((frames, views, classes))
    sums = np.zeros((frames, views, classes, 3))
    # sums in each camera's axes, which are few enough to be turned into the world's one by one; an image at a time,
    # as products of matrices
    for frame, view in np.ndindex(frames, views):
        shown = semantic[frame, view].ravel() == ids
        shown[BACKGROUND] = False
        count[frame, view] = shown.sum(1)
        points = depth[frame, view].astype(np.float32)[..., None] * rays[view]
        sums[frame, view] = shown.astype(np.float32) @ points.reshape(-1, 3)
    position = camera_position(camera_from_world)[:, :, None]
    world = sums @ camera_from_world[..., :3, :3] + count[..., None] * position
    pixels = count.sum(1)
    seen = pixels >= _LEAST_PIXELS
    return Middles(np.where(seen[..., None], world.sum(1) / np.maximum(pixels, 1)[..., None], 0.0), seen)


def visible_sizes(
    depth: Float[ndarray, "B V H W"],
    semantic: UInt8[ndarray, "B V H W"],
    intrinsics: Float[ndarray, "V 3 3"],
    camera_from_world: Float[ndarray, "B V 4 4"],
    middles: Middles,
) -> Float[ndarray, "B C"]:
    """Return the root mean square distance [m] of what some cameras see of each class from its middle.

    Args:
        depth, semantic, intrinsics, camera_from_world: as :func:`visible_middles` takes them.
        middles: that it has found; the size of what is not seen is zero.
    """
    classes = middles.seen.shape[1]
    count, squares = np.zeros(middles.seen.shape), np.zeros(middles.seen.shape)
    for frame, view in np.ndindex(*depth.shape[:2]):
        label = semantic[frame, view]
        points = unproject(depth[frame, view], intrinsics[view], camera_from_world[frame, view])
        apart = ((points - middles.place[frame, label]) ** 2).sum(-1)
        squares[frame] += np.bincount(label.ravel(), apart.ravel(), classes)
        count[frame] += np.bincount(label.ravel(), minlength=classes)
    return np.where(middles.seen, np.sqrt(squares / np.maximum(count, 1)), 0.0)


def choose_anchors(
    middles: Middles, sizes: Float[ndarray, "B C"], share: Float[ndarray, "C"], distance: float
) -> Anchors:
    """Return the classes that are seen often enough and do not stay where they are, and those that are seen too seldom.

    Args:
        middles: of all classes.
        sizes: of them where they are seen [m].
        share: of the pixels that show each.
        distance: from the cameras to things [m].
    """
    count = np.maximum(middles.seen.sum(0), 1)
    mean = middles.place.sum(0) / count[:, None]
    squared = ((middles.place - mean) ** 2).sum(-1) * middles.seen
    spread = np.sqrt(squared.sum(0) / count)
    often = middles.seen.mean(0) >= _LEAST_SEEN
    moves = often & (spread >= _LEAST_SPREAD * distance)
    moves[BACKGROUND] = False
    chosen = np.flatnonzero(moves)
    size = np.sqrt((sizes**2).sum(0) / count)
    classes, seldom = (tuple(int(c) for c in ids if c != BACKGROUND) for ids in (chosen, np.flatnonzero(~often)))
    return Anchors(classes, mean[chosen], spread[chosen], size[chosen], share[chosen], seldom)


def countable_labels(semantic: UInt8[ndarray, "*S"], valid: Bool[ndarray, "*S"] | None) -> UInt8[ndarray, "*S"]:
    """Return class ids with the background's where a pixel does not count, so that no middle is drawn there."""
    return semantic if valid is None else np.where(valid, semantic, np.uint8(BACKGROUND))


class FollowedMiddles:
    """The middles of the classes that are followed, each frame's measured when a batch first shows it.

    Every frame is drawn several times in a run, and to measure it costs as much as a quarter of its batch.

    Args:
        dataset: of the frames.
        anchors: the classes.
    """

    def __init__(self, dataset: MultiViewDataset, anchors: Anchors):
        self._classes, self._of = list(anchors.classes), len(dataset.class_names)
        self._measured = np.zeros(len(dataset), bool)
        self._place = np.zeros((len(dataset), len(self._classes), 3), np.float32)
        self._seen = np.zeros((len(dataset), len(self._classes)), bool)

    def of(
        self,
        frames: Int[ndarray, "B"],
        depth: Float[ndarray, "B V H W"],
        semantic: UInt8[ndarray, "B V H W"],
        intrinsics: Float[ndarray, "V 3 3"],
        camera_from_world: Float[ndarray, "B V 4 4"],
    ) -> Middles:
        """Return those of some frames.

        Args:
            frames: their indices in the dataset.
            depth, semantic, intrinsics, camera_from_world: of them, as :func:`visible_middles` takes them.
        """
        new = np.flatnonzero(~self._measured[frames])
        if len(new):
            found = visible_middles(depth[new], semantic[new], intrinsics, camera_from_world[new], self._of)
            self._place[frames[new]] = found.place[:, self._classes]
            self._seen[frames[new]] = found.seen[:, self._classes]
            self._measured[frames[new]] = True
        return Middles(self._place[frames], self._seen[frames])
