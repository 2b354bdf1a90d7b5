"""One frame of a dataset with all that its cameras saw, and the episode around it."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Float32, UInt8
from numpy import ndarray

from nerf_rl.cameras.tracking_frame import to_world
from nerf_rl.datasets.storage.reader import MultiViewDataset
from nerf_rl.datasets.storage.shards import SPLIT_NAMES


@dataclass(frozen=True)
class Frame:
    """What V cameras saw at one step.

    Poses and points are in the dataset's tracking frame, if it has one, which is the frame of its radiance fields.
    """

    index: int
    """in the dataset"""
    episode: int
    step: int
    """environment steps since the episode's reset"""
    split: str
    success: bool
    rgb: UInt8[ndarray, "V H W 3"]
    semantic: UInt8[ndarray, "V H W"]
    """class ids"""
    depth: Float32[ndarray, "V H W"]
    """planar [m]"""
    intrinsics: Float[ndarray, "V 3 3"]
    camera_from_world: Float[ndarray, "V 4 4"]
    far: float
    """depth where nothing is hit [m]"""
    points: dict[str, tuple[float, float, float]]
    """named positions of the true state [m], such as hand and handle"""
    origin: Float[ndarray, "3"]
    """of the tracking frame, in the world [m]; zero without one"""
    absent: tuple[str, ...] = ()
    """what of ``depth``, ``labels`` and ``state`` the dataset lacks, so that it is made up here"""
    valid: Bool[ndarray, "V H W"] | None = None
    """which pixels count; None where all do"""

    def cameras(self, views: list[int]) -> tuple[Float[ndarray, "N 3 3"], Float[ndarray, "N 4 4"], tuple[int, int]]:
        """Return the intrinsics and poses of N views, and the height and width of all [pixels]."""
        height, width = self.depth.shape[1:]
        return self.intrinsics[views], self.camera_from_world[views], (height, width)


@dataclass(frozen=True)
class EpisodeColumns:
    """Numbers along an episode of N frames."""

    steps: Float[ndarray, "N"]
    """environment steps since the reset, of which an environment that ends early has several"""
    columns: dict[str, Float[ndarray, "N"]]
    """true state [m], proprioception, actions and reward by name; none of pictures alone"""


def read_frame(dataset: MultiViewDataset, index: int) -> Frame:
    """Read one frame, see :func:`in_world` for where it was in the world."""

    def row(name: str) -> Any:
        return dataset.read(name, [index])[0]

    intrinsics, poses = dataset.tracked_cameras([index])
    valid = dataset.read_valid([index])
    return Frame(
        index,
        int(row("episode")),
        int(row("step")),
        SPLIT_NAMES[int(dataset.read_splits([index])[0])],
        bool(row("success")),
        row("rgb"),
        dataset.read_labels([index])[0],
        row("depth").astype(np.float32),
        intrinsics,
        poses[0],
        float(dataset.manifest["far"]),
        named_points(dataset.columns("privileged"), dataset.tracked_positions([index])[0]),
        dataset.tracking_origins([index])[0],
        dataset.absent,
        None if valid is None else valid[0],
    )


def in_world(frame: Frame) -> Frame:
    """Return a frame with poses and points in the world."""
    x, y, z = frame.origin.tolist()
    points = {name: (a + x, b + y, c + z) for name, (a, b, c) in frame.points.items()}
    pose = to_world(frame.camera_from_world, frame.origin)
    return replace(frame, camera_from_world=pose, points=points, origin=np.zeros(3))


def named_points(names: tuple[str, ...], values: Float[ndarray, "Q"]) -> dict[str, tuple[float, float, float]]:
    """Gather columns that are called ``NAME_x``, ``NAME_y`` and ``NAME_z`` into positions [m]."""
    by_name = dict(zip(names, values.tolist(), strict=True))
    return {stem: (by_name[f"{stem}_x"], by_name[f"{stem}_y"], by_name[f"{stem}_z"]) for stem in _positions(names)}


def position_columns(names: Sequence[str]) -> list[int]:
    """Return which columns are of positions, as :func:`named_points` gathers them."""
    whole = {f"{stem}_{axis}" for stem in _positions(names) for axis in "xyz"}
    return [column for column, name in enumerate(names) if name in whole]


def _positions(names: Sequence[str]) -> list[str]:
    stems = [name[:-2] for name in names if name.endswith("_x")]
    return [stem for stem in stems if all(f"{stem}_{axis}" in names for axis in "xyz")]


def read_columns(dataset: MultiViewDataset, frames: range) -> EpisodeColumns:
    """Read the state, actions and rewards along some frames."""
    columns: dict[str, ndarray] = {}
    for group in ("privileged", "proprio", "action"):
        values = dataset.read(f"state/{group}", frames).astype(np.float64)
        for i, name in enumerate(dataset.columns(group)):
            columns.setdefault(name, values[:, i])
    if columns:
        columns["reward"] = dataset.read("reward", frames).astype(np.float64)
    return EpisodeColumns(dataset.read("step", frames).astype(np.float64), columns)
