"""From a trial's parameters to a complete configuration of train-rl, checked by the rules of train-rl itself."""

import json
from collections.abc import Mapping
from typing import Any

from optuna.distributions import BaseDistribution, CategoricalDistribution, FloatDistribution, IntDistribution

from nerf_rl.arguments.parsing import parse_config
from nerf_rl.errors import UserError
from nerf_rl.files.outputs import plain
from nerf_rl.rl.config import TrainRLConfig
from nerf_rl.tuning.config import Range, TuneConfig

_OURS = ("out", "resume", "overwrite", "seeds", "config", "print_config", "help")
_ALONE: dict[str, Any] = {
    "envs": 1,
    "threads": 1,
    "loggers": [],
    "seeds": "",
}  # a worker for each core; the study keeps results


def trial_config(config: TuneConfig, params: Mapping[str, Any], out: str, seed: int = 0) -> TrainRLConfig:
    """Return what one training run of a trial is made of: the recipe, then the overrides, then the parameters.

    Args:
        config: of the search.
        params: values by key of train-rl; a key such as ``network.hidden.0`` is an element of a list.
        out: run folder.
        seed: which of the trial's runs; added to the recipe's seed.

    Raises:
        UserError: an unknown key, or a value that train-rl refuses.
    """
    arguments = ["--config", config.recipe] if config.recipe else []
    arguments += ["--out", out]
    values: dict[str, Any] = {**_ALONE, "evaluation_to_end": config.fitness == "mean_return", **config.overrides}
    if config.algo:
        values["algo"] = config.algo
    elements = {key: value for key, value in params.items() if _is_element(key)}
    values |= {key: value for key, value in params.items() if key not in elements}
    before = _parse(arguments, values)
    for key, value in elements.items():
        name, _, index = key.rpartition(".")
        whole = values.get(name, _value_if_any(before, name))
        if not isinstance(whole, (list, tuple)):
            raise UserError(f"--space: {key} is an element of {name or 'nothing'}, which is no list of train-rl's")
        whole = list(whole)
        if int(index) >= len(whole):
            raise UserError(f"--space: {key} is beyond the {len(whole)} elements of {name}")
        whole[int(index)] = value
        values[name] = whole
    return _parse(arguments, {**values, "seed": before.seed + seed})


def value_at(config: Any, key: str) -> Any:
    """Return the value of a dotted key; an index leads into a list."""
    for part in key.split("."):
        config = config[int(part)] if isinstance(config, list) else getattr(config, part)
    return config


def _value_if_any(config: Any, key: str) -> Any:
    try:
        return value_at(config, key)
    except (AttributeError, IndexError, ValueError):
        return None


def distributions(space: Mapping[str, Range]) -> dict[str, BaseDistribution]:
    """Return the search space in Optuna's words."""
    return {key: _distribution(searched) for key, searched in space.items()}


def start_values(config: TuneConfig) -> dict[str, Any]:
    """Return the recipe's own values of what is searched, without choices that are not among those searched."""
    base = trial_config(config, {}, "unused")
    values = {key: value_at(base, key) for key in config.space}
    return {
        key: value
        for key, value in values.items()
        if (options := config.space[key].choices) is None or value in options
    }


def check_space(config: TuneConfig) -> TrainRLConfig:
    """Return the configuration of a run at the recipe's own values, after trying the ends of every range.

    Raises:
        UserError: nothing is searched, a key that train-rl does not have or that is not to be searched, or a range that
            reaches values which train-rl refuses.
    """
    if not config.space:
        raise UserError("--space names nothing to search; rl/tune.yaml is an example")
    for key in (*config.space, *config.overrides):
        if key.split(".")[0] in _OURS:
            raise UserError(f"{key} is set for each trial by tune, so it can be neither searched nor overridden")
    if "seed" in config.space:
        raise UserError("seed cannot be searched; --seeds averages over several")
    base = trial_config(config, {}, "unused")
    for key, distribution in distributions(config.space).items():
        for value in _ends(distribution):
            trial_config(config, {key: value}, "unused")
    trial_config(config, {}, "unused", config.seeds - 1)
    return base


def _parse(arguments: list[str], values: Mapping[str, Any]) -> TrainRLConfig:
    words = [word for key, value in values.items() for word in (f"--{key}", _written(value))]
    return parse_config(TrainRLConfig, "nerf-rl train-rl", "", [*arguments, *words])


def _written(value: Any) -> str:
    return value if isinstance(value, str) else json.dumps(plain(value))


def _is_element(key: str) -> bool:
    index = key.rpartition(".")[2]
    return index.isascii() and index.isdecimal()


def _distribution(searched: Range) -> BaseDistribution:
    if searched.choices is not None:
        return CategoricalDistribution(searched.choices)
    assert searched.low is not None and searched.high is not None
    if searched.integer:
        return IntDistribution(int(searched.low), int(searched.high), searched.log, int(searched.step or 1))
    return FloatDistribution(searched.low, searched.high, searched.log, searched.step)


def _ends(distribution: BaseDistribution) -> list[Any]:
    if isinstance(distribution, CategoricalDistribution):
        return list(distribution.choices)
    assert isinstance(distribution, (FloatDistribution, IntDistribution))
    return [distribution.low, distribution.high]
