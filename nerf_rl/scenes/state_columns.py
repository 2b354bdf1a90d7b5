"""Named columns of a state for models of which nothing but their structure is known."""

from collections import Counter

import mujoco
import numpy as np
from jaxtyping import Float
from numpy import ndarray

from nerf_rl.scenes.body_parts import BodyParts, can_travel, chain, placed_name, short_name, soft_points

_SCALAR_JOINTS = (mujoco.mjtJoint.mjJNT_HINGE, mujoco.mjtJoint.mjJNT_SLIDE)


class StateColumns:
    """What the robot knows of itself, and what only the simulator knows.

    The first are position [rad or m] and velocity [rad/s or m/s] of each hinge and slide of the robot's, after the
    joints' names. The second are the positions [m] of the robot's root if it travels, of its grippers, of every other
    body that moves by a joint of its own, and of what an environment places anew in each episode, after their names.
    The points of cloth and of what else is soft are in neither.

    Args:
        model: of the scene.
        parts: which of its bodies are the robot, and what is placed.
    """

    def __init__(self, model: mujoco.MjModel, parts: BodyParts):
        soft = soft_points(model)
        joints = [
            joint
            for joint, body in enumerate(model.jnt_bodyid.tolist())
            if model.jnt_type[joint] in _SCALAR_JOINTS and model.body_rootid[body] in parts.robot and body not in soft
        ]
        self._qpos, self._qvel = model.jnt_qposadr[joints], model.jnt_dofadr[joints]
        names = [model.joint(joint).name or f"joint_{joint}" for joint in joints]
        self.proprio_names = (*names, *(f"{name}_velocity" for name in names))

        moved = {int(body) for body in model.jnt_bodyid} - soft
        roots = [root for root in parts.robot if can_travel(model, root)]
        objects = [body for body in sorted(moved) if not set(chain(model, body)) & set(parts.robot)]
        self._bodies = list(dict.fromkeys([*roots, *parts.gripper, *objects]))
        labels = _short_names([model.body(body).name or f"body_{body}" for body in self._bodies])
        placed: dict[str, int] = {}  # the first geom of each thing
        for geom in parts.placed:
            placed.setdefault(placed_name(model, geom), geom)
        self._placed = list(placed.values())
        labels += [f"{name}_placed" if name in labels else name for name in placed]
        self.privileged_names = tuple(f"{label}_{axis}" for label in labels for axis in "xyz")

    def proprio(self, data: mujoco.MjData) -> Float[ndarray, "P"]:
        """Return the values of ``proprio_names``."""
        return np.concatenate([data.qpos[self._qpos], data.qvel[self._qvel]])

    def privileged(self, data: mujoco.MjData) -> Float[ndarray, "Q"]:
        """Return the values of ``privileged_names``; positions must be propagated."""
        return np.concatenate([data.xpos[self._bodies].ravel(), data.geom_xpos[self._placed].ravel()])


def _short_names(names: list[str]) -> list[str]:
    """Return the names of bodies, shortened unless another one of them would then be called the same."""
    short = [short_name(name) or name for name in names]
    used = Counter([*short, *(name for name, shorter in zip(names, short, strict=True) if name != shorter)])
    return [shorter if used[shorter] == 1 else name for name, shorter in zip(names, short, strict=True)]


def joints(model: mujoco.MjModel) -> list[dict[str, str]]:
    """Return ``name`` and ``kind`` (free, ball, slide or hinge) of the model's joints, in the order of ``qpos``.

    A joint without a name has that of its body, where it is the body's only one, or its number.
    """
    found = []
    for joint in range(model.njnt):
        body = model.body(model.jnt_bodyid[joint])
        only = body.name if model.body_jntnum[body.id] == 1 else ""
        name = model.joint(joint).name or only or f"joint_{joint}"
        kind = mujoco.mjtJoint(model.jnt_type[joint]).name.removeprefix("mjJNT_").lower()
        found.append({"name": name, "kind": kind})
    return found
