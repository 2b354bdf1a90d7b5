"""How far from its cameras a scene is whose depth nobody knows: where they look is where something happens."""

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from nerf_rl.cameras.geometry import camera_position
from nerf_rl.errors import UserError

_LEAST_SPREAD = 1e-3  # of the axes' directions, below which they do not meet: the least eigenvalue of their mean

NEAREST, FARTHEST = 0.3, 2.5
"""limits of what cameras see, in their distances from the point that they look at: of the nearest, of the median"""


def distances_to_what_is_looked_at(
    camera_from_world: Float[ndarray, "N V 4 4"],
) -> Float[ndarray, "N V"]:
    """Return the planar depth [m] of the point that all cameras look at: the nearest to all optical axes.

    It minimises sum_i |(I - d_i d_i^T)(x - p_i)|^2 over axes with direction d_i through p_i.

    Raises:
        UserError: the axes are parallel, or there is one alone, or cameras look away from where they meet.
    """
    remedy = "so nothing tells how far off the scene is; say so with --sampling.near and --sampling.far [m]"
    poses = camera_from_world.reshape(-1, 4, 4)
    positions, axes = camera_position(poses), poses[:, 2, :3]
    across = np.eye(3) - axes[:, :, None] * axes[:, None, :]
    if np.linalg.eigvalsh(across.mean(0))[0] < _LEAST_SPREAD:
        raise UserError(f"there is no depth and the cameras look in one direction, {remedy}")
    point = np.linalg.solve(across.sum(0), np.einsum("nij,nj->i", across, positions))
    depth = np.einsum("nj,nj->n", point - positions, axes)
    if not (depth > 0).all():
        raise UserError(f"there is no depth and the cameras do not look at one point, {remedy}")
    return depth.reshape(camera_from_world.shape[:2])
