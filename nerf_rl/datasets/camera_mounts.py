"""Where a camera is: fixed in the world, fixed to a body, following a body, or one of the model's own."""

from collections.abc import Callable

import mujoco
import numpy as np
from jaxtyping import Float
from numpy import ndarray

from nerf_rl.cameras import look_at, look_from, pose_from_rotation_position
from nerf_rl.datasets.rig_config import CameraConfig
from nerf_rl.datasets.workspace import Workspace
from nerf_rl.errors import UnknownNameError, UserError

Mount = Callable[[mujoco.MjData], Float[ndarray, "4 4"]]
"""From a state with propagated positions to the camera's ``camera_from_world``."""


def mount(config: CameraConfig, model: mujoco.MjModel, workspace: Workspace) -> tuple[Mount, float, bool]:
    """Return where a camera is, its vertical field of view [degrees], and whether it moves.

    Raises:
        UserError: no such camera or body in the model, or a camera that is not a centred pinhole.
    """
    if config.camera:
        return _of_the_model(config, model)
    centre = workspace.centre if not (config.body or config.follow) else np.zeros(3)
    lookat = np.array(config.lookat or centre, np.float64)
    if config.position:
        if np.array_equal(config.position, lookat):
            raise UserError(f"camera '{config.name}' looks at the point where it is; change its position or its lookat")
        local = look_from(np.array(config.position, np.float64), lookat)
    else:
        local = look_at(lookat, config.distance or workspace.distance(config.fovy), config.azimuth, config.elevation)
    if not (config.body or config.follow):
        return lambda data: local, config.fovy, False
    body = body_id(model, config.body or config.follow, f"camera '{config.name}'")
    turns = bool(config.body)

    def pose(data: mujoco.MjData) -> Float[ndarray, "4 4"]:
        rotation = data.xmat[body].reshape(3, 3) if turns else np.eye(3)
        return local @ pose_from_rotation_position(rotation.T, data.xpos[body])

    return pose, config.fovy, True


def body_id(model: mujoco.MjModel, name: str, user: str) -> int:
    """Return the id of a body; raise UnknownNameError if there is none of this name."""
    found = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_BODY, name)
    if found < 0:
        names = (model.body(body).name for body in range(model.nbody))
        raise UnknownNameError(f"body of {user}", name, filter(None, names))
    return found


def _of_the_model(config: CameraConfig, model: mujoco.MjModel) -> tuple[Mount, float, bool]:
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

    return pose, float(model.cam_fovy[camera]), bool(moves)
