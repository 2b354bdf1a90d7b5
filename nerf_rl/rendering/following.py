"""Bodies that cameras follow without turning, as MuJoCo's ``mode="track"`` does: which ones, and from where."""

import sys
from dataclasses import dataclass

import mujoco
import numpy as np
from jaxtyping import Float
from numpy import ndarray

from nerf_rl.cameras.rig_config import AUTO, NOTHING, RigConfig
from nerf_rl.cameras.tracking_frame import TrackingFrame
from nerf_rl.errors import UnknownNameError
from nerf_rl.scenes.base import Scene
from nerf_rl.scenes.body_parts import can_travel
from nerf_rl.scenes.workspace import Workspace


@dataclass(frozen=True)
class Following:
    """A body that cameras follow."""

    frame: TrackingFrame
    """in which they stand still"""
    body: int
    """its id"""
    start: Float[ndarray, "3"]
    """where the body is at first [m]"""
    centre: Float[ndarray, "3"]
    """middle of the workspace, in the tracking frame [m]"""

    def origin(self, data: mujoco.MjData) -> Float[ndarray, "3"]:
        """Return where the tracking frame's origin is in a state with propagated positions [m]."""
        return self.frame.origin(data.xpos[self.body])

    def point(self, from_body: Float[ndarray, "3"]) -> Float[ndarray, "3"]:
        """Return a point in the tracking frame [m] that is given as seen from where the body is at first [m]."""
        return from_body + (self.start - self.frame.origin(self.start))


class Followers:
    """What the cameras of a rig follow.

    Args:
        config: of the rig.
        model: of the scene.
        workspace: of the scene.
        start: the scene's state at first, with positions propagated.

    Attributes:
        usual: what cameras follow that have no place of their own; None if nothing.

    Raises:
        UserError: ``config.follow`` is no body of the model.
    """

    def __init__(self, config: RigConfig, model: mujoco.MjModel, workspace: Workspace, start: mujoco.MjData):
        self._axes, self._model, self._workspace, self._start = config.follow_axes, model, workspace, start
        wanted = {AUTO: workspace.floating_base, NOTHING: ""}.get(config.follow, config.follow)
        self.usual = self.of(wanted, "rig.follow") if wanted else None

    def of(self, name: str, user: str) -> Following:
        """Return what it is to follow a body; ``user`` is who wants to, to be told if there is none of this name."""
        body, frame = body_id(self._model, name, user), TrackingFrame(name, self._axes)
        start = self._start.xpos[body].copy()
        if name == self._workspace.floating_base:  # the workspace remembers where that was when it was fitted
            start = self._workspace.centre - np.array(self._workspace.from_floating_base)
        return Following(frame, body, start, self._workspace.centre - frame.origin(start))


def warn_of_unnamed_travellers(config: RigConfig, scene: Scene) -> None:
    """Print a warning of each robot that travels and is not followed because its root has no name.

    Args:
        config: of the rig.
        scene: whose cameras these are.
    """
    if config.follow != AUTO or scene.workspace().floating_base:
        return
    for root in scene.parts.robot:
        if can_travel(scene.model, root) and not scene.model.body(root).name:
            print(
                f"warning: cameras do not follow the robot that travels in {scene.name}, since its root, body {root}, "
                "has no name; give it one in the model, or rig.follow a body with one, or none if cameras are to stay",
                file=sys.stderr,
            )


def body_id(model: mujoco.MjModel, name: str, user: str) -> int:
    """Return the id of a body; raise UnknownNameError if there is none of this name."""
    found = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_BODY, name)
    if found < 0:
        names = (model.body(body).name for body in range(model.nbody))
        raise UnknownNameError(f"body of {user}", name, filter(None, names))
    return found
