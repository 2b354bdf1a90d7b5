"""Multi-step returns: from a stream of steps to transitions that bootstrap n steps later."""

from collections import deque
from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from numpy import ndarray


class Transition(NamedTuple):
    """What a learner needs of n consecutive steps."""

    observation: Float[ndarray, "O"]
    """at the first of the steps"""
    action: Float[ndarray, "A"]
    """taken there"""
    reward: float
    """sum over the n steps of gamma^i r_i"""
    discount: float
    """weight of the value at next_observation: gamma^n, or 0 after a termination"""
    next_observation: Float[ndarray, "O"]
    """after the last of the steps"""


class NStep:
    """Turns the steps of one environment into n-step transitions (Watkins 1989; Sutton and Barto 2018, section 7.1).

    At the end of an episode the remaining steps become shorter transitions. A terminated episode has no future, so its
    discount is 0; a truncated one (time limit) is cut from the outside, so its last observation still has a value.
    """

    def __init__(self, n: int, gamma: float):
        self._n, self._gamma = n, gamma
        self._steps: deque[tuple[ndarray, ndarray, float]] = deque()
        self._last: ndarray | None = None

    def push(
        self,
        observation: Float[ndarray, "O"],
        action: Float[ndarray, "A"],
        reward: float,
        next_observation: Float[ndarray, "O"],
        terminated: bool,
        truncated: bool,
    ) -> list[Transition]:
        """Take one step in; return the transitions that are complete now.

        Args:
            next_observation: the true observation after the step, also at the end of an episode (not the next reset's).
        """
        self._steps.append((observation, action, reward))
        self._last = next_observation
        if terminated or truncated:
            return self.cut(terminated)
        if len(self._steps) < self._n:
            return []
        transition = self._transition(terminated=False)
        self._steps.popleft()
        return [transition]

    def cut(self, terminated: bool = False) -> list[Transition]:
        """End the episode after the last step, from the outside as a truncation."""
        transitions = []
        while self._steps:
            transitions.append(self._transition(terminated))
            self._steps.popleft()
        self._last = None
        return transitions

    def _transition(self, terminated: bool) -> Transition:
        observation, action, _ = self._steps[0]
        reward = float(np.dot(self._gamma ** np.arange(len(self._steps)), [step[2] for step in self._steps]))
        discount = 0.0 if terminated else self._gamma ** len(self._steps)
        assert self._last is not None
        return Transition(observation, action, reward, discount, self._last)
