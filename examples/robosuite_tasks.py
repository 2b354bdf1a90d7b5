"""Tasks of robosuite as scenes: `pip install robosuite`, tried with version 1.5.2.

Robosuite makes its tasks by functions of its own and gives Gymnasium no names for them. These lines do, after which
every command takes them, as long as Python finds this module:

    export PYTHONPATH=examples
    nerf-rl gen-dataset --config datasets/gym.yaml --scene gym/robosuite_tasks:Lift-v0 --out data/lift
    nerf-rl pretrain --config pretrain/demo.yaml --data data/lift --out runs/lift/encoder
    nerf-rl train-rl --config rl/gym.yaml --scene gym/robosuite_tasks:Lift-v0 \
        --encoder runs/lift/encoder --out runs/lift/agent
"""

from typing import Any

import gymnasium
import mujoco
import numpy as np
from gymnasium.spaces import Box
from numpy import ndarray

TASKS = ("Lift", "Stack", "Door", "NutAssemblySquare", "PickPlaceCan", "Wipe", "TwoArmLift")
HORIZON = 200


class RobosuiteTask(gymnasium.Env):
    """A task of robosuite with its shaped reward; the observation is its objects' state and the robot's.

    Args:
        task: its name in robosuite.
        robots: the robot, or the two of a task for two arms.
    """

    def __init__(self, task: str, robots: str | list[str] = "Panda"):
        import robosuite

        self._task = robosuite.make(
            task,
            robots=robots,
            has_renderer=False,
            has_offscreen_renderer=False,
            use_camera_obs=False,
            reward_shaping=True,
            hard_reset=False,  # to compile a model anew takes a second
            horizon=HORIZON,
            seed=0,
        )
        low, high = self._task.action_spec
        self.action_space = Box(low.astype(np.float32), high.astype(np.float32))
        size = len(_vector(self._task.observation_spec()))
        self.observation_space = Box(-np.inf, np.inf, (size,), np.float32)

    @property
    def model(self) -> mujoco.MjModel:
        """The compiled model."""
        return self._task.sim.model._model

    @property
    def data(self) -> mujoco.MjData:
        """Its state."""
        return self._task.sim.data._data

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[ndarray, dict[str, Any]]:
        """Start an episode; the seed decides where things are."""
        super().reset(seed=seed)
        if seed is not None:  # what places things keeps the generator that it was given first
            self._task.rng.bit_generator.state = np.random.default_rng(seed).bit_generator.state
        return _vector(self._task.reset()), {}

    def step(self, action: ndarray) -> tuple[ndarray, float, bool, bool, dict[str, Any]]:
        """Act for a twentieth of a second."""
        observation, reward, is_over, _ = self._task.step(action)
        return _vector(observation), reward, False, is_over, {"success": bool(self._task._check_success())}


def _vector(observation: dict[str, ndarray]) -> ndarray:
    """Return objects' and robots' parts of an observation, one after another."""
    parts = [observation[key] for key in sorted(observation) if key.endswith(("object-state", "proprio-state"))]
    return np.concatenate(parts).astype(np.float32)


for _name in TASKS:
    _robots = {"robots": ["Panda", "Panda"]} if _name.startswith("TwoArm") else {}
    gymnasium.register(f"{_name}-v0", entry_point=RobosuiteTask, kwargs={"task": _name, **_robots})
