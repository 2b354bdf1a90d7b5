"""Meta-World v3 tasks as scenes, with their traps mended."""

import warnings
from importlib.metadata import version
from typing import Any

import gymnasium
import mujoco
import numpy as np
from gymnasium.envs.mujoco import MujocoEnv
from jaxtyping import Float
from metaworld.env_dict import ALL_V3_ENVIRONMENTS_GOAL_OBSERVABLE, ENV_CLS_MAP
from metaworld.policies import ENV_POLICY_MAP
from numpy import ndarray

from nerf_rl.cameras.rig_config import CameraConfig
from nerf_rl.errors import UnknownNameError
from nerf_rl.scenes.base import METAWORLD, Policy, Scene
from nerf_rl.scenes.body_parts import named_parts
from nerf_rl.scenes.workspace import Workspace

_CENTRE, _DISTANCE = (0.0, 0.68, 0.12), 0.9  # [m] of the table's part where things are, and from where cameras see it
_PLACES = ("body_pos", "body_quat", "site_pos")  # of the model, what a task or a stored state may move
_PROPRIO = 4  # numbers at the beginning of an observation: the hand's position and the gripper's opening
_FRAME = 18  # numbers of an observation that are of now; as many of the step before follow, then the goal
_FIRST_OBJECT = {"drawer-open-v3": "handle", "drawer-close-v3": "handle", "door-open-v3": "handle"}


class SeededMetaWorld(gymnasium.Wrapper):
    """A Meta-World environment whose ``reset(seed=...)`` decides the whole episode and whose observations are true.

    Three things differ from the bare environment. A seed given to ``reset`` seeds the drawing of object positions
    (Meta-World ignores it). Nothing of the episode before is left: Meta-World lets the hand settle among the objects of
    that one, moves bodies of the model only then, and reads some positions before they follow. And positions are
    propagated after the reset, so that the first observation and the first picture show where the objects are.
    """

    def __init__(self, task: str):
        env: Any = ALL_V3_ENVIRONMENTS_GOAL_OBSERVABLE[f"{task}-goal-observable"](seed=0)
        env.seeded_rand_vec = True
        env._freeze_rand_vec = False
        super().__init__(env)
        self._places = {name: getattr(env.model, name).copy() for name in _PLACES}

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[ndarray, dict]:
        """Start an episode; with the same seed, the same episode."""
        env: Any = self.env
        if seed is not None:
            env.seed(seed)
        env.curr_path_length = 0
        self._place_bodies()
        MujocoEnv.reset(env)
        mujoco.mj_forward(env.model, env.data)
        env._prev_obs = env._get_curr_obs_combined_no_goal()
        return env._get_obs().astype(np.float64), {}

    def _place_bodies(self) -> None:
        """Move the bodies of the model to where the episode has them, for the reset to begin with.

        Only Meta-World's own reset knows the places, and moves them at its end. So it is run here with the same draws,
        without the simulation, which takes nearly all of its time.
        """
        env: Any = self.env
        for name, places in self._places.items():
            getattr(env.model, name)[:] = places
        mujoco.mj_resetData(env.model, env.data)
        mujoco.mj_forward(env.model, env.data)
        draws = env.np_random.bit_generator.state
        env.do_simulation = lambda ctrl, n_frames: None
        try:
            env.reset_model()
        finally:
            del env.do_simulation
            env.np_random.bit_generator.state = draws

    def step(self, action: ndarray) -> tuple[ndarray, float, bool, bool, dict]:
        """Act for one step of 0.0125 s x 5."""
        observation, reward, terminated, truncated, info = self.env.step(action)
        return observation, float(reward), bool(terminated), bool(truncated), info


class MetaWorldScene(Scene):
    """A Meta-World v3 task by name, such as ``drawer-open-v3``.

    Raises:
        UnknownNameError: Meta-World has no such task.
    """

    proprio_names = ("hand_x", "hand_y", "hand_z", "gripper")
    motion_names = tuple(f"{name}_change" for name in proprio_names)

    def __init__(self, task: str):
        if task not in ENV_CLS_MAP:
            raise UnknownNameError("Meta-World task", task, ENV_CLS_MAP)
        self.name = METAWORLD + task
        self._task = task
        env: Any = SeededMetaWorld(task)
        self.env = env
        env.reset(seed=0)
        self.parts = named_parts(self.model, "base", "right_hand", ("tablelink", "RetainingWall"))
        thing = _FIRST_OBJECT.get(task, "object")
        self._second = env.unwrapped._get_pos_objects().size > 3
        groups = ("hand", thing, *(("second_object",) if self._second else ()), "goal")
        self.privileged_names = tuple(f"{group}_{axis}" for group in groups for axis in "xyz")

    def proprio(self, observation: Float[ndarray, "O"]) -> Float[ndarray, "P"]:
        """Return the hand's position [m] and the gripper's opening (0 closed, 1 open)."""
        return observation[:_PROPRIO]

    def motion(self, observation: Float[ndarray, "O"]) -> Float[ndarray, "M"]:
        """Return how hand [m] and opening have changed in the last step."""
        return observation[:_PROPRIO] - observation[_FRAME : _FRAME + _PROPRIO]

    def state(self, observation: Float[ndarray, "O"]) -> Float[ndarray, "O"]:
        """Return Meta-World's observation with the change in the last step in place of the step before.

        A hand moves by millimetres in a step and by decimetres in an episode: of two positions, standardised each by
        itself, a network has to learn the difference before it knows a velocity.
        """
        now, before, goal = np.split(observation, [_FRAME, 2 * _FRAME])
        return np.concatenate([now, now - before, goal])

    def privileged(self, observation: Float[ndarray, "O"]) -> Float[ndarray, "Q"]:
        """Return the positions of the hand, the object or objects, and the goal [m]."""
        env: Any = self.env.unwrapped
        second = observation[11:14] if self._second else observation[:0]
        return np.concatenate([observation[:3], observation[4:7], second, env._target_pos])

    def observation(self) -> ndarray:
        """Return Meta-World's observation of the present state, as if nothing had moved in the last step."""
        env: Any = self.env.unwrapped
        env._prev_obs = env._get_curr_obs_combined_no_goal()
        return env._get_obs().astype(np.float64)

    def workspace(self) -> Workspace:
        """Return the part of the table where things are."""
        return Workspace(np.array(_CENTRE), _DISTANCE * float(np.sin(np.deg2rad(45.0 / 2))))

    def default_cameras(self) -> list[CameraConfig]:
        """Return three views of the table: from either side and from above."""
        views = (("left", 20.0, -30.0), ("right", 160.0, -30.0), ("top", 90.0, -70.0))
        return [
            CameraConfig(name, lookat=list(_CENTRE), distance=_DISTANCE, azimuth=azimuth, elevation=elevation)
            for name, azimuth, elevation in views
        ]

    def scripted_policy(self) -> Policy:
        """Return Meta-World's scripted policy of the task."""
        policy = ENV_POLICY_MAP[self._task]()

        def act(observation: ndarray) -> ndarray:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")  # it warns of actions beyond [-1, 1], which are clipped here
                action = policy.get_action(observation.copy())  # door-open's writes into what it reads
                return np.clip(action, -1.0, 1.0)

        return act

    def provenance(self) -> dict[str, Any]:
        """Return the task and the versions that decide what it looks like."""
        return {**super().provenance(), "metaworld": version("metaworld")}
