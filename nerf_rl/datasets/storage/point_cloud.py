"""Point clouds fused from all views of a frame."""

from collections.abc import Collection
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float, Float32, UInt8
from numpy import ndarray

from nerf_rl.cameras.geometry import camera_position, pixel_centres, pixel_directions
from nerf_rl.datasets.storage.frames import Frame
from nerf_rl.files.atomic import atomic_write
from nerf_rl.pictures.images import colour_depth, colour_labels

COLOURINGS = ("RGB", "semantic", "depth")


@dataclass(frozen=True)
class PointCloud:
    """N points with colours."""

    points: Float32[ndarray, "N 3"]
    """in the world, or in the tracking frame, as the poses of the frame [m]"""
    colours: UInt8[ndarray, "N 3"]


def unproject(
    depth: Float[ndarray, "H W"], intrinsics: Float[ndarray, "3 3"], camera_from_world: Float[ndarray, "4 4"]
) -> Float[ndarray, "H W 3"]:
    """Return the world point [m] that each pixel's centre shows at its planar depth [m]."""
    height, width = depth.shape
    directions = pixel_directions(intrinsics, camera_from_world, pixel_centres(height, width))
    return (camera_position(camera_from_world) + depth.reshape(-1, 1) * directions).reshape(height, width, 3)


def fuse_views(
    frame: Frame,
    colouring: str,
    palette: UInt8[ndarray, "C 3"],
    depth_range: tuple[float, float],
    classes: Collection[int],
    reach: float,
    most: int = 60_000,
) -> PointCloud:
    """Return the points that all views of a frame show, of pixels that count.

    Args:
        frame: what the cameras saw.
        colouring: one of ``COLOURINGS``.
        palette: colours of the classes.
        depth_range: limits of depth's colours [m].
        classes: ids of the classes to keep.
        reach: planar depth beyond which points are left out [m].
        most: number of points above which every second, third, ... is kept.
    """
    colours = {
        "RGB": lambda: frame.rgb,
        "semantic": lambda: colour_labels(frame.semantic, palette),
        "depth": lambda: colour_depth(frame.depth, *depth_range),
    }[colouring]()
    kept = (frame.depth < reach) & np.isin(frame.semantic, list(classes))
    kept = kept if frame.valid is None else kept & frame.valid
    views = range(len(frame.depth))
    points = np.stack([unproject(frame.depth[v], frame.intrinsics[v], frame.camera_from_world[v]) for v in views])
    chosen = np.flatnonzero(kept.ravel())
    chosen = chosen[:: max(1, -(-len(chosen) // most))]
    return PointCloud(points.reshape(-1, 3)[chosen].astype(np.float32), colours.reshape(-1, 3)[chosen])


def write_point_cloud(path: Path, cloud: PointCloud) -> None:
    """Write points with their colours as binary PLY."""
    import trimesh  # not needed to look at points in the browser

    with atomic_write(path) as aside:
        trimesh.PointCloud(cloud.points, cloud.colours).export(aside)
