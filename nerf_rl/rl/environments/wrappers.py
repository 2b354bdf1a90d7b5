"""What stands between a scene's environment and an agent: actions in [-1, 1], held, flat observations, and numbers."""

import traceback
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import gymnasium
import numpy as np
from gymnasium.spaces import Box, flatdim
from gymnasium.wrappers import FlattenObservation, RescaleAction
from numpy import ndarray

from nerf_rl.errors import FailureError, UserError
from nerf_rl.rl.environments.goals import GoalObservation, has_goal
from nerf_rl.rl.environments.vector import OVERTIME
from nerf_rl.scenes.base import success_in

_NO_LIMIT = 1e9
"""an action's limit from here on is none: many environments write the largest number of its type for infinity"""


class TimeLimit(gymnasium.Wrapper):
    """Truncates an episode after a number of steps; one that succeeds late may go on to show what that is worth.

    Gymnasium's wrapper of that name gives all episodes the same length.

    Args:
        env: may end an episode sooner.
        steps: of an episode, unless the option :data:`OVERTIME` of its reset makes it longer.
    """

    def __init__(self, env: gymnasium.Env, steps: int):
        super().__init__(env)
        self._steps, self._done, self._end = steps, 0, steps
        self._overtime, self._succeeded = 0, False

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        """Start an episode."""
        options = dict(options or {})
        self._overtime = options.pop(OVERTIME, 0)
        self._done, self._end, self._succeeded = 0, self._steps, False
        return self.env.reset(seed=seed, options=options or None)

    def step(self, action: Any) -> tuple[Any, Any, bool, bool, dict[str, Any]]:
        """Step; the first success may put off the end."""
        observation, reward, terminated, truncated, info = self.env.step(action)
        self._done += 1
        if not self._succeeded and success_in(info):
            self._succeeded, self._end = True, max(self._steps, self._done + self._overtime)
        return observation, reward, terminated, truncated or self._done >= self._end, info


class ActionRepeat(gymnasium.Wrapper):
    """Holds an action for several steps, stopping at the end of the episode.

    Rewards are summed. The information is reduced to ``env_steps`` (how many there were) and, if the environment tells,
    ``success`` (at any of them), which is all that crosses the border between processes.

    Raises:
        FailureError: a reward is not one finite number, or a success neither true nor false.
    """

    def __init__(self, env: gymnasium.Env, repeat: int):
        super().__init__(env)
        self._repeat = repeat

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        """Start an episode."""
        observation, _ = self.env.reset(seed=seed, options=options)
        return observation, {}

    def step(self, action: Any) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        """Hold the action."""
        total, steps = 0.0, 0
        told: list[bool] = []
        terminated = truncated = False
        observation: Any = None
        while steps < self._repeat and not (terminated or truncated):
            observation, reward, terminated, truncated, info = self.env.step(action)
            total += self._number(reward)
            success = success_in(info)
            told += [] if success is None else [success]
            steps += 1
        known = {"success": any(told)} if told else {}
        return observation, total, terminated, truncated, {"env_steps": steps, **known}

    def _number(self, reward: Any) -> float:
        value = np.asarray(reward)
        if value.size != 1 or value.dtype.kind not in "biuf" or not np.isfinite(value).all():
            raise FailureError(f"{_label(self.env)} gives a reward that is not one finite number: {reward!r}")
        return float(value.item())


class StateObservation(gymnasium.ObservationWrapper):
    """What an agent on the true state observes, as float32.

    Args:
        env: with observations in one vector.
        state: from such an observation to what is observed, as many numbers.
    """

    def __init__(self, env: gymnasium.Env, state: Callable[[ndarray], ndarray]):
        super().__init__(env)
        self._state = state
        box = env.observation_space
        assert isinstance(box, Box)
        # Meta-World's bounds change with the task's goal, so they cannot be compared between processes.
        self.observation_space = Box(-np.inf, np.inf, box.shape, np.float32)

    def observation(self, observation: ndarray) -> ndarray:
        """Return what an agent observes, as float32.

        Raises:
            FailureError: see :func:`observed_numbers`.
        """
        return observed_numbers(self, self._state(np.asarray(observation)))


def observed_numbers(env: gymnasium.Env, observation: Any) -> ndarray:
    """Return as float32 what an agent in ``env`` observes, which has to fit its ``observation_space``.

    One number that is not finite would make all of an agent's weights so, and not be seen in what it does: MuJoCo
    takes a control that is no number for zero.

    Raises:
        FailureError: there are more or fewer numbers than the space has, or one of them is not finite in 32 bits.
    """
    with np.errstate(over="ignore"):
        numbers = np.asarray(observation).astype(np.float32)
    if numbers.shape != env.observation_space.shape:
        raise FailureError(
            f"{_label(env)} is observed in {numbers.shape} numbers, where its observation_space has "
            f"{env.observation_space.shape}"
        )
    if not np.isfinite(numbers).all():
        first = int(np.flatnonzero(~np.isfinite(numbers))[0])
        raise FailureError(
            f"number {first} of the {len(numbers)} that are observed of {_label(env)} is not finite in 32 bits: "
            f"{observation[first]}"
        )
    return numbers


class TracedErrors(gymnasium.Wrapper):
    """Gives an error that nobody foresaw its traceback for words, which would stay behind in its process."""

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        """Start an episode."""
        with _traced():
            return self.env.reset(seed=seed, options=options)

    def step(self, action: Any) -> tuple[Any, Any, bool, bool, dict[str, Any]]:
        """Step."""
        with _traced():
            return self.env.step(action)


@contextmanager
def _traced() -> Iterator[None]:
    try:
        yield
    except (FailureError, UserError):
        raise
    except Exception as error:
        raise RuntimeError(f"in the process of an environment:\n{traceback.format_exc()}") from error


def with_flat_observation(env: gymnasium.Env) -> gymnasium.Env:
    """Return an environment whose observation is one vector.

    Raises:
        UserError: its observation is not made of numbers in vectors.
    """
    if has_goal(env):
        return GoalObservation(env)
    if isinstance(env.observation_space, Box) and len(env.observation_space.shape) == 1:
        return env
    if env.observation_space.is_np_flattenable and not flatdim(env.observation_space):
        raise UserError(f"observations of {_label(env)} have no numbers: {env.observation_space}")
    flat = FlattenObservation(env) if env.observation_space.is_np_flattenable else env
    if not isinstance(flat.observation_space, Box):
        raise UserError(f"observations of {_label(env)} are no vectors of numbers: {env.observation_space}")
    return flat


def with_unit_actions(env: gymnasium.Env) -> gymnasium.Env:
    """Return an environment that takes actions in [-1, 1], as agents give them.

    Raises:
        UserError: it has no continuous actions, or they have no limits, or no room between them.
    """
    space = env.action_space
    if not isinstance(space, Box) or len(space.shape) != 1:
        raise UserError(f"actions of {_label(env)} are no vectors of numbers: {space}")
    if not (np.abs([space.low, space.high]) < _NO_LIMIT).all():
        raise UserError(f"actions of {_label(env)} have no limits, so [-1, 1] cannot be scaled to them: {space}")
    if not np.issubdtype(space.dtype, np.floating) or not (space.low < space.high).all():
        raise UserError(
            f"actions of {_label(env)} must be floating-point numbers, each with a low below its high, for [-1, 1] to "
            f"be scaled to them: {space}"
        )
    if (space.low == -1).all() and (space.high == 1).all():
        return env
    return RescaleAction(env, space.dtype.type(-1.0), space.dtype.type(1.0))


def _label(env: gymnasium.Env) -> str:
    return env.spec.id if env.spec is not None else type(env.unwrapped).__name__
