"""Feature teachers: per-pixel targets for the field's feature head.

Those here take the place of a pretrained network's features in the feature loss; they are computed from depth images,
and both are exact and free in simulation. A teacher of one's own is a class that gives such features of what it sees.
"""

import functools
from collections.abc import Sequence
from typing import NamedTuple, Protocol, runtime_checkable

import numpy as np
from jaxtyping import Float, Int, UInt8
from numpy import ndarray

from nerf_rl.cameras.geometry import pixel_directions
from nerf_rl.errors import UserError
from nerf_rl.machine.extras import make_named


class Views(NamedTuple):
    """N images, and the cameras that saw them."""

    rgb: UInt8[ndarray, "N H W 3"]
    depth: Float[ndarray, "N H W"]
    """planar [m]"""
    semantic: UInt8[ndarray, "N H W"]
    """class ids"""
    intrinsics: Float[ndarray, "N 3 3"]
    camera_from_world: Float[ndarray, "N 4 4"]
    far: float
    """depth of the backdrop [m]"""


class Pixels(NamedTuple):
    """M pixels of such images."""

    image: Int[ndarray, "M"]
    row: Int[ndarray, "M"]
    column: Int[ndarray, "M"]


@runtime_checkable
class Teacher(Protocol):
    """What gives features of pixels; made without arguments, once in each process that prepares batches."""

    width: int
    """how many features a pixel has"""

    def features(self, views: Views, pixels: Pixels) -> Float[ndarray, "M F"]:
        """Return the features of some pixels, the same for the same views."""


class DepthTeacher:
    """Planar depth in units of ``far``."""

    width = 1

    def features(self, views: Views, pixels: Pixels) -> Float[ndarray, "M 1"]:
        """Return depth, at most 1."""
        return np.minimum(views.depth[tuple(pixels)], views.far)[:, None] / views.far


class NormalsTeacher:
    """Unit surface normals in world axes, towards the camera; zero where nothing is hit."""

    width = 3

    def features(self, views: Views, pixels: Pixels) -> Float[ndarray, "M 3"]:
        """Return normals."""
        return surface_normals(views.depth, views.intrinsics, views.camera_from_world, *pixels, views.far)


TEACHERS: dict[str, type[Teacher]] = {"depth": DepthTeacher, "normals": NormalsTeacher}


@functools.cache
def find_teacher(name: str) -> Teacher:
    """Return a teacher by its name, or one of the user's own by ``module:Class``.

    Raises:
        UserError: the module or its class cannot be had, or is no teacher.
    """
    if name in TEACHERS:
        return TEACHERS[name]()
    teacher = make_named("teacher", name)
    width = getattr(teacher, "width", None)
    if not (isinstance(width, int) and width > 0 and callable(getattr(teacher, "features", None))):
        raise UserError(f"'{name}' is no teacher: it needs a positive width and a method features")
    return teacher


def teacher_features(names: Sequence[str], views: Views, pixels: Pixels) -> Float[ndarray, "M F"]:
    """Return the features of pixels by several teachers, one after another; no feature at all by none.

    Raises:
        UserError: a teacher gives other than as many features as it says for each pixel.
    """
    count = len(pixels.image)
    found = [np.zeros((count, 0))]
    for name in names:
        teacher = find_teacher(name)
        features = np.asarray(teacher.features(views, pixels))
        if features.shape != (count, teacher.width):
            raise UserError(f"teacher '{name}' gave features {features.shape} where {(count, teacher.width)} were due")
        found.append(features)
    return np.concatenate(found, axis=1).astype(np.float32)


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
