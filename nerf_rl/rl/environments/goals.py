"""Tasks whose goal is part of the observation, so that an episode can be relived with another goal."""

from abc import ABC, abstractmethod
from typing import Any

import gymnasium
import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray

from nerf_rl.rl.environments.wrappers import goal_sizes


class GoalTask(ABC):
    """What hindsight relabelling has to know of a task."""

    @abstractmethod
    def achieved(self, observation: Float[ndarray, "*T O"]) -> Float[ndarray, "*T G"]:
        """Return the goal that each observation fulfils."""

    @abstractmethod
    def with_goal(self, observation: Float[ndarray, "*T O"], goal: Float[ndarray, "*T G"]) -> Float[ndarray, "*T O"]:
        """Return the observations as they would be if the goals were these."""

    @abstractmethod
    def outcome(
        self, achieved: Float[ndarray, "*T G"], goal: Float[ndarray, "*T G"]
    ) -> tuple[Float[ndarray, "*T"], Bool[ndarray, "*T"]]:
        """Return the reward for arriving at ``achieved`` and whether the episode terminates there."""


class DictGoalTask(GoalTask):
    """Goals of a Gymnasium goal environment, on the vector that ``GoalObservation`` makes of its dictionary.

    Rewards and terminations are the environment's own, by its ``compute_reward`` and, if it has one,
    ``compute_terminated``. They are asked for step by step, since not every environment takes arrays of goals.

    Args:
        env: that has them; it is not stepped.
    """

    def __init__(self, env: gymnasium.Env):
        self._env: Any = env.unwrapped
        first, second, third = goal_sizes(env)
        self._achieved = slice(first, first + second)
        self._desired = slice(first + second, first + second + third)

    def achieved(self, observation: Float[ndarray, "*T O"]) -> Float[ndarray, "*T G"]:
        """Return the achieved goals."""
        return observation[..., self._achieved]

    def with_goal(self, observation: Float[ndarray, "*T O"], goal: Float[ndarray, "*T G"]) -> Float[ndarray, "*T O"]:
        """Return the observations with other desired goals."""
        relived = observation.copy()
        relived[..., self._desired] = goal
        return relived

    def outcome(
        self, achieved: Float[ndarray, "*T G"], goal: Float[ndarray, "*T G"]
    ) -> tuple[Float[ndarray, "*T"], Bool[ndarray, "*T"]]:
        """Return the environment's rewards and terminations."""
        pairs = list(zip(achieved.reshape(-1, achieved.shape[-1]), goal.reshape(-1, goal.shape[-1]), strict=True))
        rewards = np.array([float(self._env.compute_reward(*pair, {})) for pair in pairs])
        ends = getattr(self._env, "compute_terminated", None)
        terminated = np.array([ends is not None and bool(ends(*pair, {})) for pair in pairs])
        return rewards.reshape(achieved.shape[:-1]), terminated.reshape(achieved.shape[:-1])
