"""PandaReach (Gallouedec et al. 2021, panda-gym): move the end-effector of a Franka Emika Panda to a point in space."""

import contextlib
import os
import sys
from collections.abc import Iterator
from typing import Any

import gymnasium
import numpy as np
from gymnasium.spaces import Box, Dict
from jaxtyping import Float
from numpy import ndarray

from nerf_rl.machine.extras import import_extra
from nerf_rl.rl.config import PandaReachConfig
from nerf_rl.rl.environments.goals import ACHIEVED, DESIRED, OBSERVATION

PANDA_REACH = "panda/reach"
REACHED_BELOW = 0.05  # [m] the distance at which panda-gym ends an episode
_JOINTS, _GOAL = 7, 3
_OWN = {"full": _JOINTS + 3, "paper": _JOINTS, "panda-gym": 3}
"""Numbers that each kind of observation has beside the goals: angles of the joints, velocity of the end-effector."""


class ReachRules:
    """Rewards and terminations of PandaReach.

    ``dense`` is minus the distance [m]; ``bonus`` adds 1 on arrival; ``sparse`` is 1 on arrival and 0 before. Arriving
    ends the episode.

    Args:
        reward: which of them.
    """

    def __init__(self, reward: str):
        self._reward = reward

    def compute_reward(
        self, achieved_goal: Float[ndarray, "3"], desired_goal: Float[ndarray, "3"], info: dict[str, Any]
    ) -> float:
        """Return the reward for arriving at a position [m] where another is the goal."""
        distance = np.linalg.norm(achieved_goal - desired_goal, axis=-1)
        reward = 0.0 if self._reward == "sparse" else -distance
        return float(reward + (0.0 if self._reward == "dense" else distance < REACHED_BELOW))

    def compute_terminated(
        self, achieved_goal: Float[ndarray, "3"], desired_goal: Float[ndarray, "3"], info: dict[str, Any]
    ) -> bool:
        """Tell whether that is near enough to end the episode."""
        return bool(np.linalg.norm(achieved_goal - desired_goal, axis=-1) < REACHED_BELOW)


class PandaReach(gymnasium.Env):
    """panda-gym's simulation as a goal environment with a choice of observation and reward, and ``success`` told.

    The observation is a dictionary: position of the end-effector [m] (achieved), goal [m] (desired), and beside them
    the angles of the 7 joints [rad] (``paper``), the velocity of the end-effector [m/s] (``panda-gym``) or both
    (``full``; agents then see the displacement to the goal, too). ``joints`` takes 7 actions, changes of angles of up
    to 0.05 rad a step; ``ee`` takes 3, displacements of up to 0.05 m.

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
        self._kind = config.observation
        self.observes_displacement = config.observation == "full"
        rules = ReachRules(config.reward)
        self.compute_reward, self.compute_terminated = rules.compute_reward, rules.compute_terminated
        sizes = {OBSERVATION: _OWN[config.observation], ACHIEVED: _GOAL, DESIRED: _GOAL}
        self.observation_space = Dict({name: Box(-np.inf, np.inf, (size,)) for name, size in sizes.items()})
        actions = self._simulation.action_space.shape
        self.action_space = Box(-1.0, 1.0, actions, np.float32)

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[dict, dict]:
        """Start an episode at the neutral pose, with a random goal.

        Without a seed the one before decides it, as Gymnasium has it; panda-gym's own would be of the system's entropy.
        """
        super().reset(seed=seed)
        drawn = int(self.np_random.integers(2**31)) if seed is None else seed
        observation, _ = self._simulation.reset(seed=drawn)
        return self._observed(observation), {}

    def step(self, action: ndarray) -> tuple[dict, float, bool, bool, dict[str, Any]]:
        """Act for one step of 0.04 s."""
        observation = self._simulation.step(np.asarray(action, np.float32))[0]
        goals = observation[ACHIEVED], observation[DESIRED]
        reward, reached = self.compute_reward(*goals, {}), self.compute_terminated(*goals, {})
        return self._observed(observation), reward, reached, False, {"success": reached}

    def render(self) -> ndarray:
        """Return a picture of the robot and the goal, uint8 [480, 720, 3]."""
        return self._simulation.render()

    def close(self) -> None:
        """Disconnect from the simulator."""
        self._simulation.close()

    def _observed(self, observation: dict[str, ndarray]) -> dict[str, ndarray]:
        robot, velocity = self._simulation.robot, observation[OBSERVATION][3:]
        angles = [robot.get_joint_angle(joint=joint) for joint in range(_JOINTS)]
        own = {"full": [*angles, *velocity], "paper": angles, "panda-gym": velocity}[self._kind]
        return {OBSERVATION: np.array(own), ACHIEVED: observation[ACHIEVED], DESIRED: observation[DESIRED]}


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
