"""Tasks whose goal is part of the observation, so that an episode can be relived with another goal."""

from abc import ABC, abstractmethod

from jaxtyping import Bool, Float
from numpy import ndarray


class GoalTask(ABC):
    """What hindsight relabelling has to know of a task; picklable, and without a simulator."""

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
