"""Any MJCF file as a scene."""

from pathlib import Path
from typing import Any

import gymnasium
import mujoco
import numpy as np
from jaxtyping import Float
from numpy import ndarray

from nerf_rl.errors import MissingFileError, UserError
from nerf_rl.scenes.scattering import followers_of, loose_joints, turned_around_vertical
from nerf_rl.scenes.structured import StructuredScene
from nerf_rl.scenes.workspace import fit_workspace

_CONTROL_PERIOD = 0.05  # [s] between two actions
_JOINT_SPREAD = 0.1  # at a reset, as a share of a joint's range, or at most [rad, m] without limits
_PLACE_SPREAD = 0.15  # of what may go anywhere, at a reset, as a share of the workspace's radius


class MjcfEnv(gymnasium.Env):
    """A model as a Gymnasium environment without a reward.

    Actions in [-1, 1] are scaled to the actuators' control ranges (as they are, where there is none) and held for
    0.05 s. A reset starts from the keyframe ``home``, else from the first one, else from the model's reference, and
    moves hinges and slides by up to a tenth of their range and free bodies in the plane, turned around the vertical;
    cloth, what else is soft, and what is welded or connected to something stays, and a joint that a constraint lets
    follow another follows it. The observation is [qpos, qvel].

    Args:
        model: compiled.
    """

    def __init__(self, model: mujoco.MjModel):
        self.model, self.data = model, mujoco.MjData(model)
        self._substeps = max(1, round(_CONTROL_PERIOD / model.opt.timestep))
        limited = model.actuator_ctrllimited.astype(bool)
        self._low = np.where(limited, model.actuator_ctrlrange[:, 0], -1.0)
        self._high = np.where(limited, model.actuator_ctrlrange[:, 1], 1.0)
        self._key = _home(model)
        self._start()
        self._place_spread = _PLACE_SPREAD * fit_workspace(model, self.data).radius
        self._scattered = loose_joints(model)
        self._followers = followers_of(model, self._scattered)
        self.action_space = gymnasium.spaces.Box(-1.0, 1.0, (model.nu,), np.float32)
        self.observation_space = gymnasium.spaces.Box(-np.inf, np.inf, (model.nq + model.nv,), np.float64)

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[ndarray, dict]:
        """Start an episode near the model's starting state."""
        super().reset(seed=seed)
        self._start()
        for joint in self._scattered:
            self._scatter(joint)
        for follower in self._followers:
            follower.follow(self.model, self.data.qpos)
        mujoco.mj_forward(self.model, self.data)
        return self.observe(), {}

    def step(self, action: Float[ndarray, "A"]) -> tuple[ndarray, float, bool, bool, dict]:
        """Act for one period; the reward is 0 and the episode goes on."""
        self.data.ctrl[:] = self._low + (np.clip(action, -1.0, 1.0) + 1.0) / 2.0 * (self._high - self._low)
        mujoco.mj_step(self.model, self.data, self._substeps)
        return self.observe(), 0.0, False, False, {}

    def observe(self) -> Float[ndarray, "O"]:
        """Return [qpos, qvel]."""
        return np.concatenate([self.data.qpos, self.data.qvel])

    def _start(self) -> None:
        if self._key is None:
            mujoco.mj_resetData(self.model, self.data)
        else:
            mujoco.mj_resetDataKeyframe(self.model, self.data, self._key)
        mujoco.mj_forward(self.model, self.data)

    def _scatter(self, joint: int) -> None:
        """Move a joint to a random place near where it is."""
        model, place = self.model, int(self.model.jnt_qposadr[joint])
        if model.jnt_type[joint] == mujoco.mjtJoint.mjJNT_FREE:
            qpos = self.data.qpos[place : place + 7]
            qpos[:2] += self.np_random.uniform(-self._place_spread, self._place_spread, 2)
            qpos[3:] = turned_around_vertical(qpos[3:], self.np_random)
        elif model.jnt_type[joint] in (mujoco.mjtJoint.mjJNT_HINGE, mujoco.mjtJoint.mjJNT_SLIDE):
            low, high, spread = -np.inf, np.inf, _JOINT_SPREAD
            if model.jnt_limited[joint]:
                low, high = model.jnt_range[joint]
                spread = _JOINT_SPREAD * (high - low)
            elif model.jnt_type[joint] == mujoco.mjtJoint.mjJNT_SLIDE:
                spread = min(spread, self._place_spread)
            self.data.qpos[place] = np.clip(self.data.qpos[place] + self.np_random.uniform(-spread, spread), low, high)


class MjcfScene(StructuredScene):
    """The scene of an MJCF file.

    Args:
        path: of the file; meshes and textures are found relative to it.

    Raises:
        UserError: there is no such file, MuJoCo cannot compile it, or names in it are not in UTF-8.
    """

    def __init__(self, path: str | Path):
        path = Path(path)
        if not path.is_file():
            near = sorted(str(other) for other in path.parent.glob("*.xml")) if path.parent.is_dir() else []
            nearby = f"; MJCF files in {path.parent}: {', '.join(near)}" if near else ""
            raise MissingFileError("an MJCF file", path, "no such file", f"give the path of one as scene{nearby}")
        try:
            model = mujoco.MjModel.from_xml_path(str(path))
        except ValueError as error:
            raise UserError(f"{path} is not a model that MuJoCo compiles: {' '.join(str(error).split())}") from error
        _require_utf8_names(path, model)
        self.name = str(path)
        self.env = self._env = MjcfEnv(model)
        super().__init__()

    def observation(self) -> Float[ndarray, "O"]:
        """Return [qpos, qvel]."""
        return self._env.observe()


def _require_utf8_names(path: Path, model: mujoco.MjModel) -> None:
    """Raise UserError unless all names of a model can be read; MuJoCo takes any bytes, whatever the file declares."""
    for name in model.names.split(b"\0"):
        try:
            name.decode()
        except UnicodeDecodeError as error:
            shown = name.decode("latin-1")
            raise UserError(
                f"a name in {path}, '{shown}' perhaps, is not in UTF-8, as MuJoCo's names are to be; save the "
                "file, and those that it includes, as UTF-8"
            ) from error


def _home(model: mujoco.MjModel) -> int | None:
    """Return the keyframe to start from."""
    home = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_KEY, "home")
    return home if home >= 0 else (0 if model.nkey else None)
