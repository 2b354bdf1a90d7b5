"""Where a camera is: fixed in the world, fixed to a body, following a body, or one of the model's own."""

from collections.abc import Callable
from typing import NamedTuple

import mujoco
import numpy as np
from jaxtyping import Float
from numpy import ndarray

from nerf_rl.cameras.geometry import look_at, look_from, pose_from_rotation_position
from nerf_rl.cameras.rig_config import CameraConfig
from nerf_rl.cameras.tracking_frame import to_world
from nerf_rl.errors import FailureError, UnknownNameError, UserError
from nerf_rl.rendering.following import Followers, Following, body_id
from nerf_rl.scenes.workspace import Workspace

Pose = Callable[[mujoco.MjData], Float[ndarray, "4 4"]]
"""From a state with propagated positions to the camera's ``camera_from_world``."""


class Mount(NamedTuple):
    """Where a camera is."""

    pose: Pose
    fovy: float
    """vertical field of view [degrees]"""
    moves: bool
    body: int = -1
    """body that it is fixed to or follows, or -1"""
    following: Following | None = None
    """what it follows without turning"""


def mount(
    config: CameraConfig, model: mujoco.MjModel, workspace: Workspace, followers: Followers, turn: float
) -> Mount:
    """Return where a camera is.

    Args:
        config: of the camera.
        model: of the scene.
        workspace: of the scene.
        followers: what cameras may follow.
        turn: of the azimuth of a camera that looks at the workspace's middle [degrees].

    Raises:
        UserError: no such camera or body in the model, or a camera that is not a centred pinhole.
    """
    if config.camera:
        return _of_the_model(config, model)
    label = f"camera '{config.name}'"
    following = followers.of(config.follow, label) if config.follow else None
    attached = bool(config.body or config.follow)
    fitted = not (attached or config.lookat or config.position)
    if fitted:
        following = followers.usual
    centre = workspace.centre if following is None else following.centre
    lookat = np.array(config.lookat or (np.zeros(3) if attached else centre), np.float64)
    position = np.array(config.position, np.float64)
    if config.position and np.array_equal(position, lookat):
        raise UserError(f"{label} looks at the point where it is; change its position or its lookat")
    if config.follow and following is not None:
        lookat = following.point(lookat)
        position = following.point(position) if config.position else position
    if config.position:
        local = look_from(position, lookat)
    else:
        azimuth = config.azimuth + (turn if fitted else 0.0)
        local = look_at(lookat, config.distance or workspace.distance(config.fovy), azimuth, config.elevation)
    if config.body:
        return _on_body(body_id(model, config.body, label), local, config.fovy)
    if following is None:
        return Mount(lambda data: local, config.fovy, moves=False)
    followed = following
    return Mount(lambda data: to_world(local, followed.origin(data)), config.fovy, True, followed.body, followed)


def _on_body(body: int, camera_from_body: Float[ndarray, "4 4"], fovy: float) -> Mount:
    def pose(data: mujoco.MjData) -> Float[ndarray, "4 4"]:
        rotation = data.xmat[body].reshape(3, 3)
        return camera_from_body @ pose_from_rotation_position(rotation.T, data.xpos[body])

    return Mount(pose, fovy, moves=True, body=body)


def _of_the_model(config: CameraConfig, model: mujoco.MjModel) -> Mount:
    camera = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_CAMERA, config.camera)
    if camera < 0:
        names = (model.camera(number).name for number in range(model.ncam))
        raise UnknownNameError(f"camera of the model for '{config.name}'", config.camera, filter(None, names))
    if model.cam_orthographic[camera] or model.cam_sensorsize[camera].any():
        raise UserError(
            f"camera '{config.camera}' of the model is not a pinhole given by its fovy, which is all we draw"
        )
    fovy = float(model.cam_fovy[camera])
    moves = model.cam_bodyid[camera] != 0 or model.cam_mode[camera] != mujoco.mjtCamLight.mjCAMLIGHT_FIXED

    def pose(data: mujoco.MjData) -> Float[ndarray, "4 4"]:
        if data.model.cam_fovy[camera] != fovy:
            raise FailureError(
                f"the scene changes the field of view of its camera '{config.camera}', and a dataset's camera has one "
                "alone; leave that camera out, or let resets leave it as it is"
            )
        right, up, back = data.cam_xmat[camera].reshape(3, 3).T
        return pose_from_rotation_position(np.stack([right, -up, -back]), data.cam_xpos[camera])

    body = int(model.cam_bodyid[camera])
    return Mount(pose, fovy, bool(moves), body if model.body_weldid[body] else -1)
