"""Goal environments: how goals lie in an agent's observation, so that an episode can be relived with another goal."""

from dataclasses import dataclass
from typing import Any, Protocol, runtime_checkable

import gymnasium
import numpy as np
from gymnasium.spaces import Box, Dict
from jaxtyping import Bool, Float
from numpy import ndarray

from nerf_rl.errors import FailureError, UserError

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

    def desired(self, vector: Float[ndarray, "*T O"]) -> Float[ndarray, "*T G"]:
        """Return the desired goals."""
        first = self.observation + self.goal
        return vector[..., first : first + self.goal]

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

    def desired(self, vector: Float[ndarray, "*T O"]) -> Float[ndarray, "*T G"]:
        """Return the desired goals."""
        first = vector.shape[-1] + self.start
        return vector[..., first : first + self.size]

    def with_goal(self, vector: Float[ndarray, "*T O"], goal: Float[ndarray, "*T G"]) -> Float[ndarray, "*T O"]:
        """Return the vectors as they would be if the desired goals were these."""
        relived, first = vector.copy(), vector.shape[-1] + self.start
        relived[..., first : first + self.size] = goal
        return relived


def goal_layout(env: gymnasium.Env) -> GoalLayout:
    """Return how the goals of an environment that has some lie in its observation.

    The displacement is observed where the environment's ``observes_displacement`` is true.

    Raises:
        UserError: what is achieved and what is desired have different shapes.
    """
    space = env.observation_space
    assert isinstance(space, Dict)
    sizes = {name: int(np.prod(space[name].shape or ())) for name in (OBSERVATION, ACHIEVED, DESIRED)}
    if space[ACHIEVED].shape != space[DESIRED].shape:
        raise UserError(
            f"a goal environment's {ACHIEVED} and {DESIRED} must have one shape, to be exchanged, and have "
            f"{space[ACHIEVED].shape} and {space[DESIRED].shape}"
        )
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
        shape: of the environment's goals; a vector by default.
    """

    def __init__(self, rules: GoalRules, layout: GoalLayout | GoalBesideLatent, shape: tuple[int, ...] | None = None):
        self._rules, self._layout = rules, layout
        self._shape = shape or (layout.goal if isinstance(layout, GoalLayout) else layout.size,)

    def achieved(self, observation: Float[ndarray, "*T O"]) -> Float[ndarray, "*T G"]:
        """Return the goal that each observation of the true state fulfils."""
        assert isinstance(self._layout, GoalLayout)
        return self._layout.achieved(observation)

    def with_goal(self, observation: Float[ndarray, "*T O"], goal: Float[ndarray, "*T G"]) -> Float[ndarray, "*T O"]:
        """Return the observations as they would be if the goals were these."""
        return self._layout.with_goal(observation, goal)

    def ended_by_goal(self, observation: Float[ndarray, "O"], achieved: Float[ndarray, "G"]) -> bool:
        """Tell whether it is its own goal that terminates an episode at an observation."""
        return bool(self.outcome(achieved[None], self._layout.desired(observation)[None])[1][0])

    def outcome(
        self, achieved: Float[ndarray, "*T G"], goal: Float[ndarray, "*T G"]
    ) -> tuple[Float[ndarray, "*T"], Bool[ndarray, "*T"]]:
        """Return the reward for arriving at ``achieved`` and whether the episode terminates there.

        Raises:
            FailureError: the environment cannot tell of a goal without a step's information.
        """
        shape = (-1, *self._shape)
        pairs = list(zip(achieved.reshape(shape), goal.reshape(shape), strict=True))
        try:
            rewards = np.array([float(self._rules.compute_reward(*pair, {})) for pair in pairs])
        except Exception as error:  # an environment of the user's own
            raise FailureError(
                f"compute_reward of the environment fails for a goal in hindsight, where a step's information is not "
                f"known ({type(error).__name__}: {error}); leave out --replay.hindsight"
            ) from error
        ends = getattr(self._rules, "compute_terminated", None)
        terminated = np.array([ends is not None and bool(ends(*pair, {})) for pair in pairs], dtype=np.bool_)
        return rewards.reshape(achieved.shape[:-1]), terminated.reshape(achieved.shape[:-1])
