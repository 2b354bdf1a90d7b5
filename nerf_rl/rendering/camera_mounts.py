"""Where a camera is: fixed in the world, fixed to a body, following a body, or one of the model's own."""

from collections.abc import Callable
from dataclasses import replace
from typing import NamedTuple

import mujoco
import numpy as np
from jaxtyping import Float
from numpy import ndarray

from nerf_rl.cameras.geometry import look_at, look_from, pose_from_rotation_position
from nerf_rl.cameras.rig_config import CameraConfig
from nerf_rl.errors import UnknownNameError, UserError
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


def mount(config: CameraConfig, model: mujoco.MjModel, workspace: Workspace) -> Mount:
    """Return where a camera is.

    Raises:
        UserError: no such camera or body in the model, or a camera that is not a centred pinhole.
    """
    if config.camera:
        return _of_the_model(config, model)
    attached = config.body or config.follow
    if workspace.floating_base and not (attached or config.lookat or config.position):
        config = replace(config, follow=workspace.floating_base, lookat=list(workspace.from_floating_base))
        attached = config.follow
    lookat = np.array(config.lookat or (np.zeros(3) if attached else workspace.centre), np.float64)
    if config.position:
        if np.array_equal(config.position, lookat):
            raise UserError(f"camera '{config.name}' looks at the point where it is; change its position or its lookat")
        local = look_from(np.array(config.position, np.float64), lookat)
    else:
        local = look_at(lookat, config.distance or workspace.distance(config.fovy), config.azimuth, config.elevation)
    if not attached:
        return Mount(lambda data: local, config.fovy, moves=False)
    body = body_id(model, attached, f"camera '{config.name}'")
    turns = bool(config.body)

    def pose(data: mujoco.MjData) -> Float[ndarray, "4 4"]:
        rotation = data.xmat[body].reshape(3, 3) if turns else np.eye(3)
        return local @ pose_from_rotation_position(rotation.T, data.xpos[body])

    return Mount(pose, config.fovy, moves=True, body=body)


def body_id(model: mujoco.MjModel, name: str, user: str) -> int:
    """Return the id of a body; raise UnknownNameError if there is none of this name."""
    found = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_BODY, name)
    if found < 0:
        names = (model.body(body).name for body in range(model.nbody))
        raise UnknownNameError(f"body of {user}", name, filter(None, names))
    return found


def _of_the_model(config: CameraConfig, model: mujoco.MjModel) -> Mount:
    camera = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_CAMERA, config.camera)
    if camera < 0:
        names = (model.camera(number).name for number in range(model.ncam))
        raise UnknownNameError(f"camera of the model for '{config.name}'", config.camera, filter(None, names))
    if model.cam_orthographic[camera] or model.cam_sensorsize[camera].any():
        raise UserError(
            f"camera '{config.camera}' of the model is not a pinhole given by its fovy, which is all we draw"
        )
    moves = model.cam_bodyid[camera] != 0 or model.cam_mode[camera] != mujoco.mjtCamLight.mjCAMLIGHT_FIXED

    def pose(data: mujoco.MjData) -> Float[ndarray, "4 4"]:
        right, up, back = data.cam_xmat[camera].reshape(3, 3).T
        return pose_from_rotation_position(np.stack([right, -up, -back]), data.cam_xpos[camera])

    body = int(model.cam_bodyid[camera])
    return Mount(pose, float(model.cam_fovy[camera]), bool(moves), body if model.body_weldid[body] else -1)
