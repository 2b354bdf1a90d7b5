"""Evaluation: an exact number of episodes on parallel environments, each with its own seed."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import gymnasium
import numpy as np
from jaxtyping import Bool, Float, Int
from numpy import ndarray

from nerf_rl.errors import DivergedError
from nerf_rl.metrics import wilson_interval
from nerf_rl.rl.environments.vector import reset_some, step_all
from nerf_rl.rl.training.evaluation_results import HIGH, LOW, SUCCESS, TO_END

Act = Callable[[ndarray], ndarray]
"""From observations [E, O] to actions [E, A]."""


@dataclass
class Episodes:
    """What N evaluated episodes gave, in the order of their seeds."""

    success: Bool[ndarray, "N"] | None
    """at any step; None where the environment does not tell"""
    returns: Float[ndarray, "N"]
    """sum of rewards until the episode was stopped; no numbers once an action was none"""
    length: Int[ndarray, "N"]
    """environment steps until the episode was stopped"""
    to_end: bool = False
    """whether they went on after a success"""

    def require_numbers(self, env_steps: int) -> None:
        """Raise DivergedError if returns or actions, of a policy with so many environment steps, were no numbers."""
        if not np.isfinite(self.returns.mean()):
            what = f"the mean return of {len(self.returns)} evaluated episodes, or an action in them,"
            raise DivergedError(env_steps, what)

    def summary(self) -> dict[str, Any]:
        """Return the counts and rates of ``summary.json``; the interval is Wilson's, 95 %."""
        facts: dict[str, Any] = {"episodes": len(self.returns), "mean_return": float(self.returns.mean())}
        if self.to_end:
            facts[TO_END] = True
        if self.success is None:
            return facts
        low, high = wilson_interval(int(self.success.sum()), len(self.success))
        return facts | {SUCCESS: float(self.success.mean()), LOW: low, HIGH: high}


def evaluation_seeds(seed: int, episodes: int) -> list[int]:
    """Return the seeds of ``episodes`` evaluation episodes; the first of them do not depend on how many follow."""
    return [int(np.random.default_rng([seed, 1_000_003, i]).integers(2**31)) for i in range(episodes)]


def training_seed(seed: int, env: int, episode: int) -> int:
    """Return the seed of one training episode."""
    return int(np.random.default_rng([seed, env, episode, 7]).integers(2**31))


def run_episodes(envs: gymnasium.vector.VectorEnv, act: Act, seeds: Sequence[int], to_end: bool = False) -> Episodes:
    """Run one episode for each seed and stop it at its first success, or at its end.

    An environment that is done takes the next seed, so the result depends neither on their number nor on their speed.
    When seeds run out, an idle environment is stepped along and not counted.

    Args:
        envs: with autoreset disabled; running episodes are abandoned.
        act: the deterministic policy.
        seeds: of the episodes.
        to_end: go on after a success.
    """
    count, waiting = envs.num_envs, list(range(len(seeds)))
    success, length = np.zeros(len(seeds), np.bool_), np.zeros(len(seeds), np.int64)
    returns = np.zeros(len(seeds), np.float64)
    episode: list[int | None] = [None] * count
    slot_seeds = [seeds[0]] * count
    restart, told = np.ones(count, np.bool_), False
    while True:
        for env in np.flatnonzero(restart).tolist():
            episode[env] = waiting.pop(0) if waiting else None
            slot_seeds[env] = seeds[episode[env] or 0]
        if all(index is None for index in episode):
            return Episodes(success if told else None, returns, length, to_end)
        if restart.any():
            observation = reset_some(envs, restart, slot_seeds)
        # one by one: of a batch, the last bits of a policy's products differ with the number of rows
        action = np.concatenate([act(row[None]) for row in observation])
        if not np.isfinite(action).all():  # MuJoCo would take it for zero, and go on
            return Episodes(None, np.full(len(seeds), np.nan), length)
        observation, reward, terminated, truncated, info = step_all(envs, action)
        restart = terminated | truncated
        told = told or "success" in info
        for env, index in enumerate(episode):
            if index is None:
                continue
            returns[index] += reward[env]
            length[index] += info["env_steps"][env]
            success[index] |= "success" in info and bool(info["success"][env])  # some tell of it at the end alone
            restart[env] |= success[index] and not to_end
