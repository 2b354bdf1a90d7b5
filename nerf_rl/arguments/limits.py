"""Numbers that no configuration means: they are refused before anything is allocated or waits for them."""

import dataclasses
import math
from collections.abc import Iterator
from typing import Any

from nerf_rl.errors import UserError

MOST_SEED = 2**32 - 1
"""what all generators of random numbers take"""


def require_most(config: Any, prefix: str = "", **most: int | float) -> None:
    """Check that keys of a configuration are not above what is possible.

    Args:
        config: a dataclass.
        prefix: before its keys, such as ``learner.``.
        most: the largest value of each key.

    Raises:
        UserError: one is above.
    """
    for name, largest in most.items():
        value = getattr(config, name)
        for number in value if isinstance(value, list) else [value]:
            if number is not None and number > largest:
                raise UserError(f"--{prefix}{name} must be at most {largest}, got {number}")


def require_seed(seed: int) -> None:
    """Raise UserError unless a seed is one that all generators of random numbers take."""
    if not 0 <= seed <= MOST_SEED:
        raise UserError(f"--seed must be from 0 to {MOST_SEED}, got {seed}")


def require_finite(config: Any) -> None:
    """Raise UserError if a number anywhere in a configuration is NaN or infinite."""
    for key, value in _numbers(config, ""):
        if not math.isfinite(value):
            raise UserError(f"--{key} must be a finite number, got {value}")


def _numbers(value: Any, key: str) -> Iterator[tuple[str, float]]:
    """Yield the numbers in a value, each with its dotted key."""
    prefix = f"{key}." if key else ""
    if dataclasses.is_dataclass(value):
        for field in dataclasses.fields(value):
            yield from _numbers(getattr(value, field.name), f"{prefix}{field.name}")
    elif isinstance(value, dict):
        for name, item in value.items():
            yield from _numbers(item, f"{prefix}{name}")
    elif isinstance(value, (list, tuple)):
        for item in value:
            yield from _numbers(item, key)
    elif isinstance(value, float):
        yield key, value
