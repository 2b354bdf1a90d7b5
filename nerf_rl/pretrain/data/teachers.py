"""Feature teachers: per-pixel targets for the field's feature head, computed from depth images.

They take the place of a pretrained network's features in the feature loss; both are exact and free in simulation.
"""

import numpy as np
from jaxtyping import Float, Int
from numpy import ndarray

from nerf_rl.cameras.geometry import pixel_directions

WIDTHS = {"depth": 1, "normals": 3}


def teacher_features(
    teachers: list[str],
    depth: Float[ndarray, "N H W"],
    intrinsics: Float[ndarray, "N 3 3"],
    camera_from_world: Float[ndarray, "N 4 4"],
    image: Int[ndarray, "M"],
    row: Int[ndarray, "M"],
    column: Int[ndarray, "M"],
    far: float,
) -> Float[ndarray, "M F"]:
    """Return the features of M pixels of N images.

    Args:
        teachers: ``depth`` (planar depth in units of ``far``) and ``normals`` (unit surface normals in world axes,
        towards
            the camera; zero where nothing is hit).
        depth: images [m].
        intrinsics, camera_from_world: their cameras.
        image, row, column: the pixels.
        far: depth of the backdrop [m].
    """
    columns = []
    for teacher in teachers:
        if teacher == "depth":
            columns.append(np.minimum(depth[image, row, column], far)[:, None] / far)
        else:
            columns.append(surface_normals(depth, intrinsics, camera_from_world, image, row, column, far))
    return np.concatenate(columns, axis=1).astype(np.float32)


def surface_normals(
    depth: Float[ndarray, "N H W"],
    intrinsics: Float[ndarray, "N 3 3"],
    camera_from_world: Float[ndarray, "N 4 4"],
    image: Int[ndarray, "M"],
    row: Int[ndarray, "M"],
    column: Int[ndarray, "M"],
    far: float,
) -> Float[ndarray, "M 3"]:
    """Return unit normals in world axes at some pixels; zero beyond ``far`` [m].

    Each tangent is the difference to whichever of the two neighbours is nearer in depth, so that normals next to an
    outline belong to the pixel's own surface.
    """
    offsets = np.array(
        [(0, 0), (0, 1), (0, -1), (1, 0), (-1, 0)]
    )  # (row, column): the pixel, right, left, below, above
    rows = np.clip(row[:, None] + offsets[:, 0], 0, depth.shape[1] - 1)
    columns = np.clip(column[:, None] + offsets[:, 1], 0, depth.shape[2] - 1)
    depths = depth[image[:, None], rows, columns]
    pixels = np.stack([columns, rows], axis=-1) + 0.5
    points = depths[..., None] * pixel_directions(intrinsics[image], camera_from_world[image], pixels)

    gaps = np.abs(depths - depths[:, :1])
    gaps[(rows == row[:, None]) & (columns == column[:, None])] = np.inf  # beyond the image's edge
    steps = points - points[:, :1]
    right = np.where((gaps[:, 1] <= gaps[:, 2])[:, None], steps[:, 1], -steps[:, 2])
    down = np.where((gaps[:, 3] <= gaps[:, 4])[:, None], steps[:, 3], -steps[:, 4])
    normal = np.cross(down, right)  # towards the camera, since x is right, y down and z forward
    length = np.linalg.norm(normal, axis=1, keepdims=True)
    return np.where((depths[:, :1] < far) & (length > 1e-12), normal / np.maximum(length, 1e-12), 0.0)
