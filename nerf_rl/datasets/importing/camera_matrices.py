"""Camera matrices that somebody wrote down: finite, possible, and in the convention of datasets."""

import numpy as np
from jaxtyping import Float
from numpy import ndarray

_RIGID = 1e-3  # how far a rotation's products of rows may be from those of the identity
_FARTHEST = 1e6  # of a camera from the origin [m]
_MOST_FOCAL = 1e6  # [pixels]
_OPENGL = np.diag([1.0, -1.0, -1.0, 1.0])
"""takes points of a camera with OpenGL's axes (x right, y up, z backwards) to OpenCV's, and back"""


def camera_from_opengl_pose(world_from_camera: ndarray, scale: float) -> Float[ndarray, "4 4"]:
    """Return ``camera_from_world`` of a camera whose pose in the world is given with OpenGL's axes.

    Args:
        world_from_camera: 4 x 4.
        scale: metres in a unit of its translation.

    Raises:
        ValueError: it is not rigid.
    """
    return camera_from_pose(world_from_camera @ _OPENGL, scale)


def camera_from_pose(world_from_camera: ndarray, scale: float) -> Float[ndarray, "4 4"]:
    """Return ``camera_from_world`` of a camera whose pose in the world is given with OpenCV's axes.

    What the rounding of written numbers has left of a rotation becomes one again, the nearest.

    Args:
        world_from_camera: 4 x 4.
        scale: metres in a unit of its translation.

    Raises:
        ValueError: it is not rigid.
    """
    pose = np.asarray(world_from_camera, np.float64)
    if not np.isfinite(pose).all():
        raise ValueError("a camera's pose is not finite")
    if not np.allclose(pose[3], [0.0, 0.0, 0.0, 1.0], atol=1e-6):
        raise ValueError(f"the last row of a camera's pose is {pose[3].tolist()} instead of 0, 0, 0, 1")
    rotation = pose[:3, :3]
    if np.abs(rotation @ rotation.T - np.eye(3)).max() > _RIGID or np.linalg.det(rotation) < 0:
        raise ValueError("a camera's pose is not rigid: its upper left 3 x 3 matrix is no rotation")
    position = scale * pose[:3, 3]
    if np.abs(position).max() > _FARTHEST:
        raise ValueError(f"a camera is farther than {_FARTHEST:g} m from the origin")
    left, _, right = np.linalg.svd(rotation)
    turned = (left @ right).T
    camera_from_world = np.eye(4)
    camera_from_world[:3, :3], camera_from_world[:3, 3] = turned, -turned @ position
    return camera_from_world


def checked_intrinsics(intrinsics: ndarray, height: int, width: int) -> Float[ndarray, "3 3"]:
    """Return K [pixels] of a picture after a look at it.

    Raises:
        ValueError: it is not finite, has a skew, or could not be that of such a picture.
    """
    K = np.asarray(intrinsics, np.float64)
    if not np.isfinite(K).all():
        raise ValueError("a camera's intrinsics are not finite")
    if not (0 < K[0, 0] <= _MOST_FOCAL and 0 < K[1, 1] <= _MOST_FOCAL):
        raise ValueError(f"a focal length is {K[0, 0]:g} or {K[1, 1]:g} pixels")
    if np.abs(K[[0, 1, 2, 2], [1, 0, 0, 1]]).max() > 1e-9 or K[2, 2] != 1.0:
        raise ValueError("a camera's intrinsics have a skew; K is [[fx, 0, cx], [0, fy, cy], [0, 0, 1]]")
    if not (0 <= K[0, 2] <= width and 0 <= K[1, 2] <= height):
        raise ValueError(f"a principal point, {K[0, 2]:g}, {K[1, 2]:g}, is outside of its picture")
    return K


def shrunk_intrinsics(intrinsics: Float[ndarray, "V 3 3"], factor: int) -> Float[ndarray, "V 3 3"]:
    """Return K of pictures that are so many times smaller; pixel corners, not centres, are at whole numbers."""
    K = intrinsics.copy()
    K[:, :2] /= factor
    return K
