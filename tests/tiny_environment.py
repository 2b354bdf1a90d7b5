"""A tiny environment without a simulator, which an agent learns in within a second."""

import functools
from typing import Any

import gymnasium
import numpy as np
from gymnasium.vector import AsyncVectorEnv, AutoresetMode

from nerf_rl.machine.processes import start_method
from nerf_rl.rl.environments.wrappers import ActionRepeat, TimeLimit


class Point(gymnasium.Env):
    """A point on a line, observed as [position, step]; the action moves it, the reward is minus the distance to 0.

    It starts at a place that depends on the seed. ``success`` within 0.05 of 0; with ``fall`` it terminates beyond 1.5.
    """

    observation_space = gymnasium.spaces.Box(-np.inf, np.inf, (2,), np.float32)
    action_space = gymnasium.spaces.Box(-1.0, 1.0, (1,), np.float32)

    def __init__(self, fall: bool = False):
        self._fall, self.position, self.count = fall, 0.0, 0

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[np.ndarray, dict]:
        super().reset(seed=seed)
        self.position, self.count = float(self.np_random.uniform(-1.0, 1.0)), 0
        return self._observation(), {}

    def step(self, action: np.ndarray) -> tuple[np.ndarray, float, bool, bool, dict]:
        self.position += 0.2 * float(np.clip(action[0], -1.0, 1.0))
        self.count += 1
        near = abs(self.position) < 0.05
        fallen = self._fall and abs(self.position) > 1.5
        return self._observation(), -abs(self.position), fallen, False, {"success": near, "other": "dropped"}

    def _observation(self) -> np.ndarray:
        return np.array([self.position, self.count], np.float32)


def point_env(steps: int = 10, repeat: int = 1, fall: bool = False) -> gymnasium.Env:
    return ActionRepeat(TimeLimit(Point(fall), steps), repeat)


def point_envs(count: int, **keys: Any) -> AsyncVectorEnv:
    """The tiny environment in worker processes, as :func:`nerf_rl.rl.environments.make.make_vector_env` sets it up."""
    make = functools.partial(point_env, **keys)
    return AsyncVectorEnv([make] * count, context=start_method([]), autoreset_mode=AutoresetMode.DISABLED)
