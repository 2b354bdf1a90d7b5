"""PandaReach (Gallouedec et al. 2021, panda-gym): move the end-effector of a Franka Emika Panda to a point in space."""

import contextlib
import os
import sys
from collections.abc import Iterator, Sequence
from typing import Any

import gymnasium
import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray

from nerf_rl.machine.extras import import_extra
from nerf_rl.rl.config import PandaReachConfig
from nerf_rl.rl.environments.goals import GoalTask

PANDA_REACH = "panda/reach"
REACHED_BELOW = 0.05  # [m] the distance at which panda-gym ends an episode
COLUMNS = {
    "full": ("joint_angles", "velocity", "position", "goal", "displacement"),
    "paper": ("joint_angles", "position", "goal"),
    "panda-gym": ("velocity", "position", "goal"),
}
"""Parts of each kind of observation, in their order."""
WIDTHS = {"joint_angles": 7, "velocity": 3, "position": 3, "goal": 3, "displacement": 3}


class ReachTask(GoalTask):
    """Goals and rewards of PandaReach, on its flat observation.

    ``dense`` is minus the distance [m]; ``bonus`` adds 1 on arrival; ``sparse`` is 1 on arrival and 0 before. Arriving
    ends the episode.

    Args:
        reward: which of them.
        columns: of the observation, see :data:`COLUMNS`.
    """

    def __init__(self, reward: str, columns: Sequence[str]):
        self._reward = reward
        ends = np.cumsum([WIDTHS[column] for column in columns]).tolist()
        self._place = {column: slice(end - WIDTHS[column], end) for column, end in zip(columns, ends, strict=True)}

    def achieved(self, observation: Float[ndarray, "*T O"]) -> Float[ndarray, "*T 3"]:
        """Return the position of the end-effector [m]."""
        return observation[..., self._place["position"]]

    def with_goal(self, observation: Float[ndarray, "*T O"], goal: Float[ndarray, "*T 3"]) -> Float[ndarray, "*T O"]:
        """Return the observations with another goal."""
        relived = observation.copy()
        relived[..., self._place["goal"]] = goal
        if "displacement" in self._place:
            relived[..., self._place["displacement"]] = goal - self.achieved(observation)
        return relived

    def outcome(
        self, achieved: Float[ndarray, "*T 3"], goal: Float[ndarray, "*T 3"]
    ) -> tuple[Float[ndarray, "*T"], Bool[ndarray, "*T"]]:
        """Return rewards and terminations."""
        distance = np.linalg.norm(achieved - goal, axis=-1)
        reached = np.asarray(distance < REACHED_BELOW)
        reward = np.zeros_like(distance) if self._reward == "sparse" else -distance
        return np.asarray(reward + (0.0 if self._reward == "dense" else reached)), reached


def reach_task(config: PandaReachConfig) -> ReachTask:
    """Return the task that belongs to a configuration."""
    return ReachTask(config.reward, COLUMNS[config.observation])


class PandaReach(gymnasium.Env):
    """panda-gym's simulation with a flat observation, the choice of reward, and ``success`` in the information.

    The observation is float32: of angles of the 7 joints [rad], velocity of the end-effector [m/s], its position [m],
    the goal [m] and the displacement to it [m], those in :data:`COLUMNS`. ``joints`` takes 7 actions, changes of angles
    of up to 0.05 rad a step; ``ee`` takes 3, displacements of up to 0.05 m.

    Args:
        config: control, reward and observation.

    Raises:
        UserError: panda-gym is not installed.
    """

    metadata = {"render_modes": ["rgb_array"]}
    render_mode = "rgb_array"

    def __init__(self, config: PandaReachConfig):
        with _without_greeting():
            envs = import_extra("panda_gym.envs", "panda", f"scene {PANDA_REACH}")
            self._simulation: Any = envs.PandaReachEnv(reward_type="dense", control_type=config.control)
        self._columns = COLUMNS[config.observation]
        self._task = reach_task(config)
        size = sum(WIDTHS[column] for column in self._columns)
        self.observation_space = gymnasium.spaces.Box(-np.inf, np.inf, (size,), np.float32)
        actions = self._simulation.action_space.shape
        self.action_space = gymnasium.spaces.Box(-1.0, 1.0, actions, np.float32)

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[ndarray, dict]:
        """Start an episode at the neutral pose, with a random goal."""
        observation, _ = self._simulation.reset(seed=seed)
        return self._flat(observation), {}

    def step(self, action: ndarray) -> tuple[ndarray, float, bool, bool, dict[str, Any]]:
        """Act for one step of 0.04 s."""
        observation = self._simulation.step(np.asarray(action, np.float32))[0]
        reward, reached = self._task.outcome(observation["achieved_goal"], observation["desired_goal"])
        return self._flat(observation), float(reward), bool(reached), False, {"success": bool(reached)}

    def render(self) -> ndarray:
        """Return a picture of the robot and the goal, uint8 [480, 720, 3]."""
        return self._simulation.render()

    def close(self) -> None:
        """Disconnect from the simulator."""
        self._simulation.close()

    def _flat(self, observation: dict[str, ndarray]) -> Float[ndarray, "O"]:
        robot = self._simulation.robot
        parts = {
            "joint_angles": [robot.get_joint_angle(joint=joint) for joint in range(7)],
            "velocity": observation["observation"][3:],
            "position": observation["achieved_goal"],
            "goal": observation["desired_goal"],
            "displacement": observation["desired_goal"] - observation["achieved_goal"],
        }
        return np.concatenate([parts[column] for column in self._columns]).astype(np.float32)


@contextlib.contextmanager
def _without_greeting() -> Iterator[None]:
    """Keep PyBullet's C code from printing its build time and its arguments to the standard output and error."""
    kept = [(stream, os.dup(stream.fileno())) for stream in (sys.__stdout__, sys.__stderr__) if stream is not None]
    sink = os.open(os.devnull, os.O_WRONLY)
    try:
        for stream, _ in kept:
            stream.flush()
            os.dup2(sink, stream.fileno())
        yield
    finally:
        for stream, descriptor in kept:
            stream.flush()
            os.dup2(descriptor, stream.fileno())
            os.close(descriptor)
        os.close(sink)
