"""Demonstrations: episodes of the scene's scripted policy, acted in the agent's own environments before it learns.

Actions have noise, for a script without any leaves a critic blind beside its path; only episodes with a success are
kept. Observations, rewards, action repeat and length are those of training, and the seeds are those of neither training
nor evaluation.
"""

from collections.abc import Sequence
from typing import Any, NamedTuple

import gymnasium
import numpy as np
from jaxtyping import Float
from numpy import ndarray

from nerf_rl.errors import FailureError
from nerf_rl.rl.environments.scripted import SCRIPTED_ACTION
from nerf_rl.rl.environments.vector import call_all, reset_some, step_all
from nerf_rl.rl.experience.n_step import NStep, Transition
from nerf_rl.rl.training.learnt_reward import learnt_reward

_TRIES = 10  # for each episode that is wanted


class Demonstration(NamedTuple):
    """An acted episode of T agent steps."""

    observations: Float[ndarray, "T+1 O"]
    actions: Float[ndarray, "T A"]
    """as they were acted, with noise, in [-1, 1]"""
    rewards: Float[ndarray, "T"]
    """as they are learnt from"""
    terminated: bool
    """otherwise its last step is a truncation"""
    success: bool
    """at any step"""
    env_steps: int

    def transitions(self, n: int, gamma: float) -> list[Transition]:
        """Return its n-step transitions, as training makes them."""
        n_step, last = NStep(n, gamma), len(self.actions) - 1
        made: list[Transition] = []
        for t, (action, reward) in enumerate(zip(self.actions, self.rewards, strict=True)):
            ends = (self.terminated, not self.terminated) if t == last else (False, False)
            made += n_step.push(self.observations[t], action, float(reward), self.observations[t + 1], *ends)
        return made


class Demonstrations(NamedTuple):
    """What was acted to have as many successful episodes as were wanted."""

    kept: list[Demonstration]
    """those with a success, in the order of their seeds"""
    tries: int
    """episodes that were acted"""
    env_steps: int
    """of all of them"""


def demonstration_seeds(seed: int, episode: int) -> tuple[int, np.random.Generator]:
    """Return the seed of a demonstration and what draws its noise."""
    return int(np.random.default_rng([seed, 1_000_033, episode]).integers(2**31)), np.random.default_rng(
        [seed, 1_000_037, episode]
    )


def act_demonstrations(
    envs: gymnasium.vector.VectorEnv, count: int, noise: float, seed: int, success_bonus: float = 0.0
) -> Demonstrations:
    """Act until ``count`` episodes have had a success.

    No more are acted at a time than are still wanted, so that what is kept and what was spent depend on the seed, and
    not on the number of environments.

    Args:
        envs: with autoreset disabled, around :class:`~nerf_rl.rl.environments.scripted.ScriptedActions`.
        count: episodes to keep.
        noise: standard deviation of the noise on actions.
        seed: of the run.
        success_bonus: of the run, see :func:`nerf_rl.rl.training.learnt_reward.learnt_reward`.

    Raises:
        FailureError: the script succeeds in fewer than one of ten episodes.
    """
    kept: list[Demonstration] = []
    tries, env_steps = 0, 0
    while len(kept) < count:
        if tries >= _TRIES * count:
            raise FailureError(
                f"the scripted policy succeeded in {len(kept)} of {tries} episodes, too few for --demonstrations "
                f"{count}; lower --demonstration_noise or --action_repeat, or raise --episode_steps"
            )
        number = min(envs.num_envs, count - len(kept))
        for episode in _act(envs, noise, seed, range(tries, tries + number), success_bonus):
            tries, env_steps = tries + 1, env_steps + episode.env_steps
            kept += [episode] if episode.success else []
    return Demonstrations(kept, tries, env_steps)


def _act(envs: Any, noise: float, seed: int, episodes: Sequence[int], success_bonus: float) -> list[Demonstration]:
    """Act an episode in each of the first environments; the others are stepped along, and not counted."""
    count, size = len(episodes), int(np.prod(envs.single_action_space.shape))
    drawn = [demonstration_seeds(seed, episode) for episode in episodes]
    seeds = [env_seed for env_seed, _ in drawn] + [0] * (envs.num_envs - count)
    observation = reset_some(envs, np.ones(envs.num_envs, np.bool_), seeds)
    steps: list[list[tuple[ndarray, ndarray, float]]] = [[] for _ in episodes]
    env_steps, success = np.zeros(count, np.int64), np.zeros(count, np.bool_)
    done: dict[int, Demonstration] = {}
    while len(done) < count:
        script = np.stack(call_all(envs, SCRIPTED_ACTION))
        for env, (_, rng) in enumerate(drawn):
            script[env] += noise * rng.standard_normal(size)
        action = np.clip(script, -1.0, 1.0).astype(np.float32)
        next_observation, reward, terminated, truncated, info = step_all(envs, action)
        reward = learnt_reward(reward, info, success_bonus)
        ended = terminated | truncated
        for env in [env for env in range(count) if env not in done]:
            steps[env].append((observation[env], action[env], float(reward[env])))
            env_steps[env] += info["env_steps"][env]
            success[env] |= "success" in info and bool(info["success"][env])
            if ended[env]:
                observations, actions, rewards = (np.stack(part) for part in zip(*steps[env], strict=True))
                observations = np.concatenate([observations, next_observation[env][None]])
                facts = (bool(terminated[env]), bool(success[env]), int(env_steps[env]))
                done[env] = Demonstration(observations, actions, rewards, *facts)
        observation = next_observation
        if ended.any() and len(done) < count:
            observation = reset_some(envs, ended, seeds)
    return [done[env] for env in range(count)]
