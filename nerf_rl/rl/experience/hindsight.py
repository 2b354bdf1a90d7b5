"""Hindsight experience replay: an episode is also remembered as if what was reached had been its goal."""

from collections.abc import Callable

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from nerf_rl.rl.environments.goals import GoalTask
from nerf_rl.rl.experience.n_step import Transition


class Hindsight:
    """Collects the steps of one environment; at the end of an episode, returns them with other goals.

    For each step ``copies`` goals are drawn, by two strategies of Andrychowicz et al. 2017, section 4.5: ``future``
    from what the same or a later step of the episode achieved, and a share by ``random`` from what was achieved at any
    time in training. The first show what leads to a goal, the second what leads away from it. Rewards, terminations and
    n-step returns are worked out for the new goal, and a relabelled path ends where it reaches it. (TorchRL's
    ``HERReplayBuffer`` relabels single steps when it draws them and keeps their termination, so it knows neither n-step
    returns nor an end at the new goal.)

    Args:
        task: gives goals and rewards.
        copies: relabelled transitions for each step.
        n, gamma: as in :class:`nerf_rl.rl.experience.n_step.NStep`.
        rng: draws the goals.
        draw_goals: returns that many goals achieved at any time in training [count, G]; None for ``future`` alone.
        random_share: of the goals drawn by it.
    """

    def __init__(
        self,
        task: GoalTask,
        copies: int,
        n: int,
        gamma: float,
        rng: np.random.Generator,
        draw_goals: Callable[[int], Float[ndarray, "count G"]] | None = None,
        random_share: float = 0.0,
    ):
        self._task, self._copies, self._n, self._gamma, self._rng = task, copies, n, gamma, rng
        self._draw_goals, self._random_share = draw_goals, random_share
        self._observations: list[ndarray] = []
        self._actions: list[ndarray] = []
        self._next_observations: list[ndarray] = []
        self._achieved: list[ndarray] = []

    def push(
        self,
        observation: Float[ndarray, "O"],
        action: Float[ndarray, "A"],
        next_observation: Float[ndarray, "O"],
        terminated: bool,
        truncated: bool,
        achieved: Float[ndarray, "G"] | None = None,
    ) -> list[Transition]:
        """Take one step in; return the episode's relabelled transitions when it has ended.

        Args:
            observation, action, next_observation: of the step.
            terminated, truncated: whether the episode was with it. One that terminates at anything but its goal, such
                as a fall, terminates there whatever its goal.
            achieved: the goal that it fulfilled; None if ``next_observation`` tells.
        """
        self._observations.append(observation)
        self._actions.append(action)
        self._next_observations.append(next_observation)
        self._achieved.append(self._task.achieved(next_observation) if achieved is None else achieved)
        if not (terminated or truncated):
            return []
        return self.cut(terminated and not self._task.ended_by_goal(next_observation, self._achieved[-1]))

    def cut(self, fell: bool = False) -> list[Transition]:
        """End the episode, which may have been at something that ends it whatever its goal; return its transitions."""
        length = len(self._actions)
        transitions = []
        if length:
            observations, next_observations = np.stack(self._observations), np.stack(self._next_observations)
            achieved = np.stack(self._achieved)
            for _ in range(self._copies):
                goals = self._goals(achieved)
                relabelled = [
                    self._relabel(observations, next_observations, t, achieved, goals[t], fell) for t in range(length)
                ]
                transitions += relabelled
        self._observations, self._actions, self._next_observations, self._achieved = [], [], [], []
        return transitions

    def _goals(self, achieved: Float[ndarray, "T G"]) -> Float[ndarray, "T G"]:
        """Draw a goal for each step."""
        length = len(achieved)
        later = achieved[self._rng.integers(np.arange(length), length)]
        if self._draw_goals is None:
            return later
        elsewhere = self._rng.random((length, 1)) < self._random_share
        return np.where(elsewhere, self._draw_goals(length), later)

    def _relabel(
        self,
        observations: Float[ndarray, "T O"],
        next_observations: Float[ndarray, "T O"],
        first: int,
        achieved: Float[ndarray, "T G"],
        goal: Float[ndarray, "G"],
        fell: bool,
    ) -> Transition:
        """Return the transition that begins at step ``first`` with another goal."""
        until = min(first + self._n, len(achieved))
        rewards, terminated = self._task.outcome(
            achieved[first:until], np.broadcast_to(goal, (until - first, goal.size))
        )
        ends = np.flatnonzero(terminated)
        count = int(ends[0]) + 1 if len(ends) else until - first
        over = bool(len(ends)) or (fell and until == len(achieved))
        return Transition(
            self._task.with_goal(observations[first], goal),
            self._actions[first],
            float(np.dot(self._gamma ** np.arange(count), rewards[:count])),
            0.0 if over else self._gamma**count,
            self._task.with_goal(next_observations[first + count - 1], goal),
        )
