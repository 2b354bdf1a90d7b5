"""Between a parameter's values and coordinates in [0, 1], on which a continuous search can work.

A number has one coordinate, on a logarithmic scale if its distribution has one; whole numbers and steps have equal
shares of it. A choice has a coordinate for each option, and the greatest wins, so no order is put on the options.
"""

import math
from collections.abc import Sequence
from typing import Any

from optuna.distributions import BaseDistribution, CategoricalDistribution, FloatDistribution, IntDistribution


def width(distribution: BaseDistribution) -> int:
    """Return the number of coordinates of a parameter."""
    return len(distribution.choices) if isinstance(distribution, CategoricalDistribution) else 1


def encode(distribution: BaseDistribution, value: Any) -> list[float]:
    """Return the coordinates of a value; a number outside the range counts as the end of the range."""
    if isinstance(distribution, CategoricalDistribution):
        chosen = distribution.to_internal_repr(value)
        return [float(index == chosen) for index in range(len(distribution.choices))]
    low, high, margin = _bounds(distribution)
    number = min(max(float(value), low), high)
    start, end = _scale(distribution, low - margin), _scale(distribution, high + margin)
    return [(_scale(distribution, number) - start) / (end - start)] if end > start else [0.5]


def decode(distribution: BaseDistribution, coordinates: Sequence[float]) -> Any:
    """Return the value at some coordinates."""
    if isinstance(distribution, CategoricalDistribution):
        return distribution.choices[max(range(len(distribution.choices)), key=lambda index: coordinates[index])]
    low, high, margin = _bounds(distribution)
    start, end = _scale(distribution, low - margin), _scale(distribution, high + margin)
    number = start + coordinates[0] * (end - start)
    number = math.exp(number) if _is_log(distribution) else number
    step = getattr(distribution, "step", None)
    if step is not None:
        number = low + round((number - low) / step) * step
    number = float(f"{number:.12g}")  # without the rounding errors of logarithms, which would show in recipes
    number = min(max(number, low), high)
    return int(number) if isinstance(distribution, IntDistribution) else number


def _bounds(distribution: BaseDistribution) -> tuple[float, float, float]:
    """Return the ends of a range, and half a step that is added on each side so that all steps have equal shares."""
    assert isinstance(distribution, (FloatDistribution, IntDistribution))
    return float(distribution.low), float(distribution.high), (distribution.step or 0.0) / 2


def _is_log(distribution: BaseDistribution) -> bool:
    return bool(getattr(distribution, "log", False))


def _scale(distribution: BaseDistribution, number: float) -> float:
    return math.log(number) if _is_log(distribution) else number
