"""Cameras in the 3-D scene: frusta with what they saw, through which a click looks."""

import numpy as np
import viser
import viser.transforms as vtf
from jaxtyping import Float, UInt8
from numpy import ndarray

from nerf_rl.cameras.geometry import camera_position, field_of_view
from nerf_rl.viewer.node_names import node_name

_DEPTH = 0.09  # of a frustum [m]
_COLOURS = {"encoder": (40, 120, 220), "supervision": (120, 120, 120), "test": (230, 140, 30)}


def add_frustum(
    server: viser.ViserServer,
    name: str,
    role: str,
    intrinsics: Float[ndarray, "3 3"],
    camera_from_world: Float[ndarray, "4 4"],
    image: UInt8[ndarray, "H W 3"],
) -> viser.CameraFrustumHandle:
    """Put a camera into the scene, coloured by its role."""
    height, width = image.shape[:2]
    wxyz, position = frustum_pose(camera_from_world)
    frustum = server.scene.add_camera_frustum(
        node_name("cameras", name),
        fov=field_of_view(intrinsics, height),
        aspect=width / height,
        scale=_DEPTH,
        thickness=2.0,
        thickness_units="screen",
        color=_COLOURS.get(role, (120, 120, 120)),
        image=image,
        wxyz=wxyz,
        position=position,
    )
    frustum.on_click(lambda event: _look_through(event, frustum))
    return frustum


def frustum_pose(camera_from_world: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the quaternion (w, x, y, z) and the position [m] of a camera in the world; both use OpenCV's axes."""
    rotation = vtf.SO3.from_matrix(camera_from_world[:3, :3].T)
    return rotation.wxyz, camera_position(camera_from_world)


def _look_through(event: viser.SceneNodePointerEvent, frustum: viser.CameraFrustumHandle) -> None:
    """Move the camera of the browser that clicked into a frustum."""
    pose = vtf.SE3.from_rotation_and_translation(vtf.SO3(np.asarray(frustum.wxyz)), np.asarray(frustum.position))
    camera = event.client.camera
    with event.client.atomic():
        camera.position = pose.translation()
        camera.look_at = pose.translation() + pose.rotation().as_matrix()[:, 2] * 0.8
        camera.up_direction = -pose.rotation().as_matrix()[:, 1]
        camera.fov = frustum.fov
