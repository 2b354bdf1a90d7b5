"""What a scene is: a MuJoCo environment with named state columns."""

import functools
import hashlib
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from typing import Any

import gymnasium
import mujoco
import numpy as np
from jaxtyping import Float
from numpy import ndarray

from nerf_rl.cameras.rig_config import CameraConfig
from nerf_rl.errors import FailureError
from nerf_rl.scenes.body_parts import BodyParts
from nerf_rl.scenes.render_data import RenderData
from nerf_rl.scenes.simulation import simulation_of
from nerf_rl.scenes.workspace import Workspace

METAWORLD, GYM = "metaworld/", "gym/"
"""what the names of scenes begin with"""
_SUCCESS = ("success", "is_success", "succeed", "solved")  # names that environments give it in a step's information

Policy = Callable[[Any], ndarray]
"""From an observation to an action [A] in [-1, 1]."""


class Scene(ABC):
    """A MuJoCo environment behind the Gymnasium interface, with names for what it holds."""

    name: str
    """the name that :func:`nerf_rl.scenes.make.make_scene` takes"""
    env: gymnasium.Env
    """``reset(seed=...)`` decides everything random in the episode"""
    parts: BodyParts
    """which bodies are the robot, its gripper and the surroundings"""
    proprio_names: tuple[str, ...]
    """what the robot knows of itself"""
    motion_names: tuple[str, ...] = ()
    """how that changes, for agents that see by an encoder, where ``proprio_names`` have no velocities"""
    privileged_names: tuple[str, ...]
    """what only the simulator knows: hand, objects and goal [m]"""

    @property
    def model(self) -> mujoco.MjModel:
        """The simulated model."""
        return simulation_of(self.env).model

    @property
    def data(self) -> mujoco.MjData:
        """The simulation's state."""
        return simulation_of(self.env).data

    @property
    def drawn_model(self) -> mujoco.MjModel:
        """What :meth:`render_data` is of, for who draws: it stays where episodes compile models that are made alike."""
        return self._drawn.model

    def render_data(self) -> mujoco.MjData:
        """Return the state to be drawn, with positions propagated from ``qpos``; the simulation is untouched."""
        return self._drawn.now()

    @functools.cached_property
    def _drawn(self) -> RenderData:
        return RenderData(self.env)

    @abstractmethod
    def proprio(self, observation: Any) -> Float[ndarray, "P"]:
        """Return the values of ``proprio_names``."""

    def motion(self, observation: Any) -> Float[ndarray, "M"]:
        """Return the values of ``motion_names``."""
        return np.zeros(0)

    def state(self, observation: Float[ndarray, "O"]) -> Float[ndarray, "O"]:
        """Return what an agent on the true state observes of the environment's observation in one vector: all of it."""
        return observation

    @abstractmethod
    def privileged(self, observation: Any) -> Float[ndarray, "Q"]:
        """Return the values of ``privileged_names``."""

    @abstractmethod
    def workspace(self) -> Workspace:
        """Return where something happens, after a reset."""

    @abstractmethod
    def default_cameras(self) -> list[CameraConfig]:
        """Return cameras that suit the scene."""

    @abstractmethod
    def observation(self) -> Any:
        """Return the environment's observation of its present state."""

    def scripted_policy(self) -> Policy | None:
        """Return a fresh instance of the task's scripted policy, or None if it has none."""
        return None

    def set_state(
        self,
        qpos: Float[ndarray, "nq"],
        qvel: Float[ndarray, "nv"],
        mocap_pos: Float[ndarray, "nmocap 3"] | None = None,
        mocap_quat: Float[ndarray, "nmocap 4"] | None = None,
    ) -> None:
        """Put the simulation into a state and propagate positions."""
        self.data.qpos[:], self.data.qvel[:] = qpos, qvel
        if mocap_pos is not None and mocap_quat is not None:
            self.data.mocap_pos[:], self.data.mocap_quat[:] = mocap_pos, mocap_quat
        mujoco.mj_forward(self.model, self.data)

    def provenance(self) -> dict[str, Any]:
        """Return what identifies the scene."""
        return {"name": self.name, "mujoco": mujoco.__version__}


def success_in(info: Mapping[str, Any]) -> bool | None:
    """Return whether a step's information tells of success, and None if it tells nothing of it.

    Raises:
        FailureError: it tells of something that is neither true nor false.
    """
    name, found = next(((key, info[key]) for key in _SUCCESS if key in info), ("", None))
    if found is None:
        return None
    value = np.asarray(found)
    if value.size != 1 or value.dtype.kind not in "biuf" or bool(np.isnan(value).any()):
        raise FailureError(f"a step's information has the {name} {found!r}, which is neither true nor false")
    return bool(value.item())


def model_digest(model: mujoco.MjModel) -> str:
    """Return the SHA-256 of a compiled model, which covers meshes and textures that an MJCF file refers to."""
    buffer = np.empty(mujoco.mj_sizeModel(model), np.uint8)
    mujoco.mj_saveModel(model, None, buffer)
    return hashlib.sha256(buffer.tobytes()).hexdigest()
