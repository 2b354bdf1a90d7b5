"""The state of a simulation as it is drawn: the one that ``qpos`` holds, wherever the simulation is in its step."""

import copy

import gymnasium
import mujoco
import numpy as np
from numpy import ndarray

from nerf_rl.scenes.simulation import simulation_of

_MADE_OF = ("mesh_", "skin_", "tex_", "hfield_")  # what OpenGL is given
_GIVEN_ANEW = ("tex_data", "hfield_data", "hfield_size")  # of it, where they change
_STRUCTURE = (
    *("names", "body_parentid", "body_mocapid", "body_jntnum", "jnt_type", "jnt_bodyid", "cam_bodyid", "cam_mode"),
    *("geom_type", "geom_bodyid", "geom_dataid", "geom_group", "light_bodyid", "mat_texid"),
)


class RenderData:
    """Propagates positions from a simulation's state, in a copy.

    After ``mj_step`` MuJoCo's positions are those of one substep before ``qpos``. They are propagated in a copy,
    because environments may read the old ones in their next step.

    Many environments compile their model anew at each reset (dm_control's manipulation, robosuite). As long as the new
    one differs in values alone, such as places, sizes and colours, they are copied into one that stays, so that whoever
    draws may keep what was made for it.

    Args:
        env: on MuJoCo; what has been moved in its model is read at each call.
    """

    def __init__(self, env: gymnasium.Env):
        self._env = env
        self._model = self._followed = simulation_of(env).model
        self._is_own = False
        self._copy = mujoco.MjData(self._model)

    @property
    def model(self) -> mujoco.MjModel:
        """What states are of now: the simulation's, or from the second one made alike on a copy with its values."""
        self._follow(simulation_of(self._env).model)
        return self._model

    def now(self) -> mujoco.MjData:
        """Return the state to draw, which the next call overwrites; the simulation is untouched."""
        model, data, shown = self.model, simulation_of(self._env).data, self._copy
        shown.qpos[:], shown.qvel[:], shown.time = data.qpos, data.qvel, data.time
        shown.mocap_pos[:], shown.mocap_quat[:] = data.mocap_pos, data.mocap_quat
        mujoco.mj_kinematics(model, shown)
        mujoco.mj_comPos(model, shown)
        mujoco.mj_camlight(model, shown)
        mujoco.mj_flex(model, shown)
        mujoco.mj_tendon(model, shown)
        return shown

    def _follow(self, model: mujoco.MjModel) -> None:
        """Take over the values of the model that the simulation has now, or that itself if it is made otherwise."""
        if model is self._followed:
            return
        is_alike = _made_alike(self._model, model)
        if self._is_own and is_alike:
            for name in _arrays(model):
                getattr(self._model, name)[...] = getattr(model, name)
        else:
            self._is_own = is_alike
            self._model = copy.deepcopy(model) if is_alike else model
            self._copy = mujoco.MjData(self._model)
        self._followed = model


def _made_alike(one: mujoco.MjModel, other: mujoco.MjModel) -> bool:
    """Tell whether two models have the same elements, in the same order and made of the same meshes."""
    sizes = [name for name in dir(one) if name.startswith("n") and isinstance(getattr(one, name), int)]
    if any(getattr(one, name) != getattr(other, name) for name in sizes):
        return False
    made_of = [name for name in _arrays(one) if name.startswith(_MADE_OF) and name not in _GIVEN_ANEW]
    return all(_equal(getattr(one, name), getattr(other, name)) for name in (*_STRUCTURE, *made_of))


def _equal(one: bytes | ndarray, other: bytes | ndarray) -> bool:
    """Tell whether two values are the same; a polygon of a mesh without an area has normals that are no numbers."""
    return np.array_equal(one, other, equal_nan=np.asarray(one).dtype.kind == "f")


def _arrays(model: mujoco.MjModel) -> list[str]:
    return [name for name in dir(model) if name[0] != "_" and isinstance(getattr(model, name), np.ndarray)]
