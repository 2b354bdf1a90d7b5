"""Goal environments: how goals lie in an agent's observation, so that an episode can be relived with another goal."""

from dataclasses import dataclass
from typing import Any, Protocol, runtime_checkable

import gymnasium
import numpy as np
from gymnasium.spaces import Box, Dict
from jaxtyping import Bool, Float
from numpy import ndarray

OBSERVATION, ACHIEVED, DESIRED = "observation", "achieved_goal", "desired_goal"
"""parts of a goal environment's observation, after Gymnasium-Robotics"""


@runtime_checkable
class GoalRules(Protocol):
    """What decides an environment's reward, and perhaps the end of an episode, from a step's goals alone.

    A ``compute_terminated`` with the same arguments is optional; without one no goal ends an episode.
    """

    def compute_reward(self, achieved_goal: Any, desired_goal: Any, info: Any) -> Any:
        """Return the reward for arriving at ``achieved_goal``."""
        ...


def has_goal(env: gymnasium.Env) -> bool:
    """Tell whether an environment is one with exchangeable goals, as Gymnasium-Robotics defines them.

    One whose goals are dictionaries, such as FrankaKitchen's of a goal for each appliance, is none.
    """
    space = env.observation_space
    if not isinstance(space, Dict) or set(space.spaces) != {OBSERVATION, ACHIEVED, DESIRED}:
        return False
    return all(isinstance(part, Box) for part in space.values()) and hasattr(env.unwrapped, "compute_reward")


@dataclass(frozen=True)
class GoalLayout:
    """A goal environment's dictionary as one vector: observation, achieved goal, desired goal and their difference."""

    observation: int
    """numbers of the observation"""
    goal: int
    """numbers of a goal"""
    displacement: bool = False
    """whether the way from the achieved to the desired goal is observed, too"""

    @property
    def size(self) -> int:
        """Numbers of the vector, O."""
        return self.observation + (3 if self.displacement else 2) * self.goal

    def vector(self, parts: dict[str, ndarray]) -> Float[ndarray, "O"]:
        """Return the parts one after another."""
        observation, achieved, desired = (np.ravel(parts[name]) for name in (OBSERVATION, ACHIEVED, DESIRED))
        return np.concatenate([observation, achieved, desired, *([desired - achieved] if self.displacement else [])])

    def achieved(self, vector: Float[ndarray, "*T O"]) -> Float[ndarray, "*T G"]:
        """Return the achieved goals."""
        return vector[..., self.observation : self.observation + self.goal]

    def with_goal(self, vector: Float[ndarray, "*T O"], goal: Float[ndarray, "*T G"]) -> Float[ndarray, "*T O"]:
        """Return the vectors as they would be if the desired goals were these."""
        relived, desired = vector.copy(), self.observation + self.goal
        relived[..., desired : desired + self.goal] = goal
        if self.displacement:
            relived[..., desired + self.goal :] = goal - self.achieved(vector)
        return relived


@dataclass(frozen=True)
class GoalBesideLatent:
    """Where the desired goal lies in what an agent with an encoder observes, whose user asked for it by name.

    It does not observe what is achieved, such as where a block is: :class:`AchievedGoal` tells hindsight alone.
    """

    start: int
    """of the goal, counted from the end: negative"""
    size: int
    """numbers of the goal"""

    def with_goal(self, vector: Float[ndarray, "*T O"], goal: Float[ndarray, "*T G"]) -> Float[ndarray, "*T O"]:
        """Return the vectors as they would be if the desired goals were these."""
        relived, first = vector.copy(), vector.shape[-1] + self.start
        relived[..., first : first + self.size] = goal
        return relived


def goal_layout(env: gymnasium.Env) -> GoalLayout:
    """Return how the goals of an environment that has some lie in its observation.

    The displacement is observed where the environment's ``observes_displacement`` is true.
    """
    space = env.observation_space
    assert isinstance(space, Dict)
    sizes = {name: int(np.prod(space[name].shape or ())) for name in (OBSERVATION, ACHIEVED, DESIRED)}
    assert sizes[ACHIEVED] == sizes[DESIRED]
    return GoalLayout(sizes[OBSERVATION], sizes[DESIRED], getattr(env.unwrapped, "observes_displacement", False))


class GoalObservation(gymnasium.ObservationWrapper):
    """A goal environment's dictionary as one vector, see :class:`GoalLayout`."""

    def __init__(self, env: gymnasium.Env):
        super().__init__(env)
        self._layout = goal_layout(env)
        self.observation_space = Box(-np.inf, np.inf, (self._layout.size,), np.float64)

    def observation(self, observation: dict[str, ndarray]) -> Float[ndarray, "O"]:
        """Return the parts one after another."""
        return self._layout.vector(observation)


class AchievedGoal(gymnasium.Wrapper):
    """Tells in its information which goal each step of a goal environment achieved."""

    def step(self, action: Any) -> tuple[Any, Any, bool, bool, dict[str, Any]]:
        """Step."""
        observation, reward, terminated, truncated, info = self.env.step(action)
        return observation, reward, terminated, truncated, {**info, ACHIEVED: np.ravel(observation[ACHIEVED])}


class GoalTask:
    """What hindsight relabelling has to know of a task, on what an agent observes.

    Rewards and terminations are the environment's own. They are asked for step by step, since not every environment
    takes arrays of goals.

    Args:
        rules: the environment's.
        layout: of the agent's observations, which :class:`GoalObservation` makes, or a latent with goals beside.
    """

    def __init__(self, rules: GoalRules, layout: GoalLayout | GoalBesideLatent):
        self._rules, self._layout = rules, layout

    def achieved(self, observation: Float[ndarray, "*T O"]) -> Float[ndarray, "*T G"]:
        """Return the goal that each observation of the true state fulfils."""
        assert isinstance(self._layout, GoalLayout)
        return self._layout.achieved(observation)

    def with_goal(self, observation: Float[ndarray, "*T O"], goal: Float[ndarray, "*T G"]) -> Float[ndarray, "*T O"]:
        """Return the observations as they would be if the goals were these."""
        return self._layout.with_goal(observation, goal)

    def outcome(
        self, achieved: Float[ndarray, "*T G"], goal: Float[ndarray, "*T G"]
    ) -> tuple[Float[ndarray, "*T"], Bool[ndarray, "*T"]]:
        """Return the reward for arriving at ``achieved`` and whether the episode terminates there."""
        pairs = list(zip(achieved.reshape(-1, achieved.shape[-1]), goal.reshape(-1, goal.shape[-1]), strict=True))
        rewards = np.array([float(self._rules.compute_reward(*pair, {})) for pair in pairs])
        ends = getattr(self._rules, "compute_terminated", None)
        terminated = np.array([ends is not None and bool(ends(*pair, {})) for pair in pairs], dtype=np.bool_)
        return rewards.reshape(achieved.shape[:-1]), terminated.reshape(achieved.shape[:-1])
