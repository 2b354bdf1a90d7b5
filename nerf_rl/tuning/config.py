"""What a hyper-parameter search is made of; importing this module loads nothing heavy."""

import math
from dataclasses import asdict, dataclass, field
from typing import Annotated, Any, Literal

from nerf_rl.arguments.limits import Count, Limits, Natural, Processes, Seed, Share, check_values
from nerf_rl.errors import UserError


@dataclass
class Range:
    """Where one key of train-rl is searched: from low to high, or among choices."""

    low: float | None = None
    """least value"""
    high: float | None = None
    """greatest value"""
    log: bool = False
    """search on a logarithmic scale"""
    integer: bool = False
    """whole numbers only"""
    step: float | None = None
    """distance between neighbouring values"""
    choices: list[Any] | None = None
    """values without an order, instead of low and high"""

    def check(self, key: str) -> None:
        """Raise UserError, naming the key that is searched, if there is no such range."""
        bounds = [number for number in (self.low, self.high, self.step) if number is not None]
        if self.choices is not None:
            if bounds or self.log or self.integer:
                raise UserError(f"--space: {key} has choices, so it can have nothing else")
            if not self.choices or not all(isinstance(choice, (str, int, float, bool)) for choice in self.choices):
                raise UserError(f"--space: {key}'s choices must be words, numbers, true or false, got {self.choices}")
            return
        if self.low is None or self.high is None:
            raise UserError(f"--space: {key} needs low and high, or choices")
        if not all(math.isfinite(number) for number in bounds):
            raise UserError(f"--space: {key}'s low, high and step must be finite numbers, got {bounds}")
        if self.low > self.high:
            raise UserError(f"--space: {key}'s low {self.low:g} is above its high {self.high:g}")
        if self.log and self.low <= 0:
            raise UserError(f"--space: {key} has a logarithmic scale, so its low must be above 0, got {self.low:g}")
        if self.log and self.step is not None:
            raise UserError(f"--space: {key} can have a logarithmic scale or a step, not both")
        if self.step is not None and self.step <= 0:
            raise UserError(f"--space: {key}'s step must be positive, got {self.step:g}")
        if self.step is not None and self.low < self.high < self.low + self.step:
            raise UserError(f"--space: {key}'s step {self.step:g} is larger than what lies between low and high")
        if self.integer and any(number != int(number) for number in bounds):
            raise UserError(f"--space: {key} is an integer, so low, high and step must be whole numbers")


@dataclass
class WhaleConfig:
    """The Whale Optimisation Algorithm; of no effect with other samplers."""

    population: Annotated[int, Limits(least=2)] = 10
    """whales in a generation"""
    mode: Literal["faithful", "shift_invariant"] = "faithful"
    """faithful: the authors' program, with its origin at the recipe's values; shift_invariant: no preferred place"""

    def __post_init__(self) -> None:
        check_values(self, "whale.")


@dataclass
class TuneConfig:
    """Keys of ``nerf-rl tune``."""

    out: str
    """output folder"""
    space: dict[str, Range] = field(default_factory=dict)
    """what is searched: from a key of train-rl, such as learner.actor_rate or network.hidden.0, to its range"""
    recipe: str = ""
    """recipe of train-rl that trials start from; empty: train-rl's defaults"""
    overrides: dict[str, Any] = field(default_factory=dict)
    """keys of train-rl that are other than in the recipe, such as env_steps"""
    algo: str = ""
    """algorithm of train-rl; empty: the recipe's"""
    sampler: Literal["whale", "tpe", "cmaes", "random"] = "whale"
    """whale, tpe, cmaes or random"""
    whale: WhaleConfig = field(default_factory=WhaleConfig)
    """the whale sampler"""
    trials: Count = 50
    """trials of the study, over all workers and machines"""
    env_steps_total: Natural = 0
    """environment steps of all trials together, instead of trials; 0: trials counts"""
    seeds: Count = 1
    """training seeds that a trial's fitness is the mean of"""
    fitness: Literal["mean_return", "success_rate"] = "mean_return"
    """mean_return (undiscounted, whole episodes) or success_rate, of each run's last evaluation"""
    prune: bool = False
    """stop trials whose evaluations are below the median of others at the same step"""
    prune_after: Share = 0.3
    """share of a run's env_steps before which nothing is pruned"""
    workers: Processes = 2
    """processes, each with a trial at a time"""
    storage: str = ""
    """journal file or URL of Optuna's; empty: a journal in the output folder"""
    study: str = "tune"
    """name of the study in the storage; machines that give the same storage and name share it"""
    keep_runs: bool = False
    """keep the run folder of each trial"""
    seed: Seed = 0
    """seed of the search"""
    resume: bool = False
    """go on with an interrupted study"""
    overwrite: bool = False
    """replace an existing output folder; a study in a storage elsewhere stays, and is gone on with"""

    def __post_init__(self) -> None:
        check_values(self)
        for key, searched in self.space.items():
            searched.check(key)

    def content(self) -> dict[str, Any]:
        """Return the keys that must not change when a study is resumed or shared."""
        free = ["out", "trials", "env_steps_total", "workers", "storage", "study", "keep_runs", "resume", "overwrite"]
        return {key: value for key, value in asdict(self).items() if key not in free}
