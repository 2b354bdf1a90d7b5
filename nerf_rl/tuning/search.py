"""A study's sampler and pruner, in words that can be sent to worker processes and compared between machines."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from optuna import Study
from optuna.distributions import BaseDistribution
from optuna.pruners import BasePruner, MedianPruner, NopPruner
from optuna.samplers import BaseSampler, CmaEsSampler, RandomSampler, TPESampler
from optuna.trial import FrozenTrial

from nerf_rl.tuning.config import TuneConfig
from nerf_rl.tuning.pruner import EarlierMedianPruner
from nerf_rl.tuning.recipe import distributions, start_values
from nerf_rl.tuning.sampler import WhaleSampler


@dataclass(frozen=True)
class Search:
    """How a study proposes and prunes."""

    space: dict[str, BaseDistribution]
    """what is searched"""
    sampler: str = "whale"
    """whale, tpe, cmaes or random"""
    start: dict[str, Any] = field(default_factory=dict)
    """known good values"""
    population: int = 10
    """whales in a generation"""
    iterations: int = 5
    """generations over which whales narrow their search"""
    mode: str = "faithful"
    """of the whale algorithm"""
    prune: bool = False
    """stop poor trials"""
    prune_after: int = 0
    """steps before which nothing is pruned"""
    seed: int = 0
    """of the search"""

    def make_sampler(self, stream: Sequence[int], wait: Callable[[Study, FrozenTrial], None]) -> BaseSampler:
        """Return the sampler of one worker.

        Args:
            stream: numbers that no other worker has, nor this one when it is started again: samplers other than the
                whale draw a random stream of their own for each.
            wait: see :class:`~nerf_rl.tuning.sampler.WhaleSampler`.
        """
        seed = int(np.random.SeedSequence([self.seed, *stream]).generate_state(1)[0])
        if self.sampler == "tpe":
            return TPESampler(seed=seed)
        if self.sampler == "cmaes":
            return CmaEsSampler(seed=seed, warn_independent_sampling=False)
        if self.sampler == "random":
            return RandomSampler(seed=seed)
        return WhaleSampler(
            self.population, self.iterations, self.mode, self.seed, start=self.start, space=self.space, wait=wait
        )

    def make_pruner(self) -> BasePruner:
        """Return the pruner."""
        if not self.prune:
            return NopPruner()
        if self.sampler == "whale":
            return EarlierMedianPruner(warmup_steps=self.prune_after)
        return MedianPruner(n_startup_trials=4, n_warmup_steps=self.prune_after)


def search_of(config: TuneConfig, trials: int, env_steps: int) -> Search:
    """Return the search that a configuration describes.

    Args:
        config: of the search.
        trials: of the study.
        env_steps: of one training run.
    """
    return Search(
        distributions(config.space),
        config.sampler,
        start_values(config),
        config.whale.population,
        math.ceil(trials / config.whale.population),
        config.whale.mode,
        config.prune,
        int(config.prune_after * env_steps),
        config.seed,
    )
