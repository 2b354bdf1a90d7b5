"""The scene's scripted policy inside an agent's environment, for demonstrations."""

from collections.abc import Callable
from typing import Any

import gymnasium
from jaxtyping import Float
from numpy import ndarray

from nerf_rl.scenes.base import Policy

SCRIPTED_ACTION = "scripted_action"
"""the method of :class:`ScriptedActions`, which is found through all wrappers around it"""


class ScriptedActions(gymnasium.Wrapper):
    """Knows what the scene's scripted policy would do next, whatever acts.

    It stands right around the scene's environment, for the script reads the environment's own observation. An agent,
    outside, sees another one: a latent, say.

    Args:
        env: with actions in [-1, 1].
        make_policy: returns a fresh instance of the script for an episode.
    """

    def __init__(self, env: gymnasium.Env, make_policy: Callable[[], Policy | None]):
        super().__init__(env)
        self._make_policy = make_policy
        self._policy: Policy | None = None
        self._observation: Any = None

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        """Start an episode, the script anew."""
        self._observation, info = self.env.reset(seed=seed, options=options)
        self._policy = self._make_policy()
        return self._observation, info

    def step(self, action: Any) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        """Act, and keep what is observed."""
        self._observation, reward, terminated, truncated, info = self.env.step(action)
        return self._observation, float(reward), terminated, truncated, info

    def scripted_action(self) -> Float[ndarray, "A"]:
        """Return the script's action in the present state, in [-1, 1]; ask once for each action, as it may count."""
        assert self._policy is not None, "no episode has begun"
        return self._policy(self._observation)
