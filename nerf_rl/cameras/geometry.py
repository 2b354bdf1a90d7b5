"""Pinhole cameras: intrinsics, poses, projection and rays, as pure functions over NumPy arrays.

One convention everywhere. Camera axes are OpenCV's (x right, y down, z forward); the world is MuJoCo's, in metres.
Pixel (column i, row j) covers [i, i + 1) x [j, j + 1), so its centre is (i + 0.5, j + 0.5). ``camera_from_world`` is
the 4x4 matrix [R | t] that takes world points to camera points; ``projection`` is K [R | t], 3x4. Depth is planar: the
z coordinate in the camera's frame, in metres, not the distance along the ray. Leading dimensions are free.
"""

import numpy as np
from jaxtyping import Float
from numpy import ndarray


def intrinsics_from_fovy(fovy_deg: float, height: int, width: int) -> Float[ndarray, "3 3"]:
    """Return K [pixels] of a camera with square pixels and a centred principal point.

    Args:
        fovy_deg: vertical field of view [degrees], as in MJCF.
        height, width: image size [pixels].
    """
    focal = height / (2.0 * np.tan(np.deg2rad(fovy_deg) / 2.0))
    return np.array([[focal, 0.0, width / 2.0], [0.0, focal, height / 2.0], [0.0, 0.0, 1.0]])


def field_of_view(intrinsics: Float[ndarray, "3 3"], height: int) -> float:
    """Return the vertical field of view [rad] of K [pixels]."""
    return float(2.0 * np.arctan(height / (2.0 * intrinsics[1, 1])))


def look_at(
    lookat: Float[ndarray, "3"], distance: float, azimuth_deg: float, elevation_deg: float
) -> Float[ndarray, "4 4"]:
    """Return ``camera_from_world`` of a camera that looks at a point, with MuJoCo's meaning of azimuth and elevation.

    Args:
        lookat: point on the optical axis [m].
        distance: from the camera to ``lookat`` [m].
        azimuth_deg: heading of the viewing direction around world z, 0 along +x [degrees].
        elevation_deg: inclination of the viewing direction, negative looks down [degrees], above -90 and below 90.
    """
    azimuth, elevation = np.deg2rad([azimuth_deg, elevation_deg])
    forward = np.array([np.cos(elevation) * np.cos(azimuth), np.cos(elevation) * np.sin(azimuth), np.sin(elevation)])
    right = np.array([np.sin(azimuth), -np.cos(azimuth), 0.0])
    down = np.cross(forward, right)
    rotation = np.stack([right, down, forward])
    position = np.asarray(lookat, dtype=np.float64) - distance * forward
    return pose_from_rotation_position(rotation, position)


def look_from(position: Float[ndarray, "3"], lookat: Float[ndarray, "3"]) -> Float[ndarray, "4 4"]:
    """Return ``camera_from_world`` of a camera at a position that looks at a point, upright as far as it can be.

    Args:
        position: optical centre [m].
        lookat: point on the optical axis [m].
    """
    forward = np.asarray(lookat, np.float64) - position
    forward = forward / np.linalg.norm(forward)
    right = np.cross(forward, [0.0, 0.0, 1.0])
    if np.linalg.norm(right) < 1e-9:  # straight up or down: the top of the image is where y grows
        right = np.array([1.0, 0.0, 0.0])
    right = right / np.linalg.norm(right)
    return pose_from_rotation_position(np.stack([right, np.cross(forward, right), forward]), position)


def pose_from_rotation_position(
    rotation: Float[ndarray, "3 3"], position: Float[ndarray, "3"]
) -> Float[ndarray, "4 4"]:
    """Return ``camera_from_world`` from the rows (right, down, forward) in world axes and the camera's position [m]."""
    pose = np.eye(4)
    pose[:3, :3] = rotation
    pose[:3, 3] = -rotation @ position
    return pose


def camera_position(camera_from_world: Float[ndarray, "*B 4 4"]) -> Float[ndarray, "*B 3"]:
    """Return the optical centre in the world [m]."""
    rotation, translation = camera_from_world[..., :3, :3], camera_from_world[..., :3, 3]
    return -np.einsum("...ji,...j->...i", rotation, translation)


def projection_matrix(
    intrinsics: Float[ndarray, "*B 3 3"], camera_from_world: Float[ndarray, "*B 4 4"]
) -> Float[ndarray, "*B 3 4"]:
    """Return P = K [R | t]."""
    return intrinsics @ camera_from_world[..., :3, :]


def project(
    projection: Float[ndarray, "*B 3 4"], points: Float[ndarray, "*B N 3"]
) -> tuple[Float[ndarray, "*B N 2"], Float[ndarray, "*B N"]]:
    """Project world points [m] to pixel coordinates (x, y); also return their planar depth [m] (negative: behind)."""
    homogeneous = points @ np.swapaxes(projection[..., :3], -1, -2) + projection[..., None, :, 3]
    depth = homogeneous[..., 2]
    return homogeneous[..., :2] / depth[..., None], depth


def pixel_directions(
    intrinsics: Float[ndarray, "*B 3 3"],
    camera_from_world: Float[ndarray, "*B 4 4"],
    pixels: Float[ndarray, "*B N 2"],
) -> Float[ndarray, "*B N 3"]:
    """Return world directions through pixel coordinates (x, y), scaled to unit planar depth.

    With this scale, ``camera_position + depth * direction`` is the surface point at planar depth ``depth``.
    """
    x = (pixels[..., 0] - intrinsics[..., None, 0, 2]) / intrinsics[..., None, 0, 0]
    y = (pixels[..., 1] - intrinsics[..., None, 1, 2]) / intrinsics[..., None, 1, 1]
    local = np.stack([x, y, np.ones_like(x)], axis=-1)
    return local @ camera_from_world[..., :3, :3]


def pixel_centres(height: int, width: int) -> Float[ndarray, "N 2"]:
    """Return the centres (x, y) of all pixels in row-major order, N = height * width."""
    rows, columns = np.mgrid[0:height, 0:width]
    return np.stack([columns.ravel(), rows.ravel()], axis=-1) + 0.5
