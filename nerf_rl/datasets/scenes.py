"""Scenes: a MuJoCo environment with named state columns, found by name."""

from abc import ABC, abstractmethod
from collections.abc import Callable
from typing import Any

import gymnasium
import mujoco
from jaxtyping import Float
from numpy import ndarray

from nerf_rl.errors import UserError

METAWORLD = "metaworld/"

Policy = Callable[[ndarray], ndarray]
"""From an observation [O] to an action [A] in [-1, 1]."""


class Scene(ABC):
    """A MuJoCo environment behind the Gymnasium interface, with names for what it holds."""

    name: str
    """the name that :func:`make_scene` takes"""
    env: gymnasium.Env
    """``reset(seed=...)`` decides everything random in the episode; positions are current after a reset or a step"""
    proprio_names: tuple[str, ...]
    """what the robot knows of itself"""
    privileged_names: tuple[str, ...]
    """what only the simulator knows: hand, objects and goal [m]"""
    robot_body: str | None = None
    """root body of the robot, if known"""
    gripper_body: str | None = None
    """root body of the gripper, if known"""

    @property
    def model(self) -> mujoco.MjModel:
        """The simulated model."""
        return self.env.unwrapped.model  # type: ignore[attr-defined]

    @property
    def data(self) -> mujoco.MjData:
        """The simulation's state."""
        return self.env.unwrapped.data  # type: ignore[attr-defined]

    @abstractmethod
    def proprio(self, observation: Float[ndarray, "O"]) -> Float[ndarray, "P"]:
        """Return the values of ``proprio_names``."""

    @abstractmethod
    def privileged(self, observation: Float[ndarray, "O"]) -> Float[ndarray, "Q"]:
        """Return the values of ``privileged_names``."""

    def scripted_policy(self) -> Policy | None:
        """Return a fresh instance of the task's scripted policy, or None if it has none."""
        return None

    def provenance(self) -> dict[str, Any]:
        """Return what identifies the scene."""
        return {"name": self.name, "mujoco": mujoco.__version__}


def make_scene(name: str) -> Scene:
    """Return a fresh scene.

    Args:
        name: ``metaworld/TASK``, for example ``metaworld/drawer-open-v3``.

    Raises:
        UserError: no scene has this name.
    """
    if not name.startswith(METAWORLD):
        raise UserError(f"unknown scene '{name}'; available: {METAWORLD}TASK, for example {METAWORLD}drawer-open-v3")
    from nerf_rl.datasets.metaworld_scene import MetaWorldScene  # Meta-World takes a second to import

    return MetaWorldScene(name.removeprefix(METAWORLD))
