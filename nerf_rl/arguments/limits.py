"""What values keys take, said in their types: numbers within limits, or one of a few words.

A key of the type ``Annotated[int, Limits(least=1)]`` or ``Literal["fast", "full"]`` is checked by :func:`check_values`,
and ``--help`` shows what it takes. Upper limits are there for what no configuration means: such numbers are refused
before anything is allocated or waits for them.
"""

import dataclasses
import math
import types
import typing
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Annotated, Any

from nerf_rl.errors import UnknownNameError, UserError


@dataclass(frozen=True, kw_only=True)
class Limits:
    """Between what a number must be."""

    least: int | float = -math.inf
    above: int | float = -math.inf
    most: int | float = math.inf
    below: int | float = math.inf

    def __repr__(self) -> str:
        words = [self._low(), self._high()]
        return self._interval() or next((each for each in words if each), "any")

    def refusal(self, value: int | float) -> str:
        """Return what a number would have to be, if it is not: a whole interval, or for integers the end to mind."""
        if isinstance(value, float) and not math.isfinite(value):
            return "a finite number"
        low, high = value >= self.least and value > self.above, value <= self.most and value < self.below
        if low and high:
            return ""
        return (isinstance(value, float) and self._interval()) or (self._high() if low else self._low())

    def _interval(self) -> str:
        low, high = max(self.least, self.above), min(self.most, self.below)
        if math.inf in (-low, high):
            return ""
        return f"in {'(' if low == self.above else '['}{low}, {high}{')' if high == self.below else ']'}"

    def _low(self) -> str:
        if self.above > self.least:
            return "positive" if self.above == 0 else f"above {self.above}"
        return "" if self.least == -math.inf else f"at least {self.least}"

    def _high(self) -> str:
        if self.below < self.most:
            return f"below {self.below}"
        return "" if self.most == math.inf else f"at most {self.most}"


Count = Annotated[int, Limits(least=1)]
Natural = Annotated[int, Limits(least=0)]
Positive = Annotated[float, Limits(above=0)]
NotNegative = Annotated[float, Limits(least=0)]
Share = Annotated[float, Limits(least=0, most=1)]
PositiveShare = Annotated[float, Limits(above=0, most=1)]
ShareBelowOne = Annotated[float, Limits(least=0, below=1)]
Processes = Annotated[int, Limits(least=1, most=1024)]
"""processes, threads or devices"""
MOST_SEED = 2**32 - 1
"""what all generators of random numbers take"""
Seed = Annotated[int, Limits(least=0, most=MOST_SEED)]


def check_values(config: Any, prefix: str = "") -> None:
    """Check that the keys of a configuration are what their types say.

    Args:
        config: a dataclass; not those in it, which check themselves.
        prefix: before its keys, such as ``learner.``.

    Raises:
        UserError: one is not.
    """
    for name, hint in typing.get_type_hints(type(config), include_extras=True).items():
        for rule, value in _rules(hint, getattr(config, name)):
            if not isinstance(rule, Limits):
                if value not in rule:
                    raise UnknownNameError(f"{prefix}{name}", value, rule)
            elif refusal := rule.refusal(value):
                raise UserError(f"--{prefix}{name} must be {refusal}, got {value}")


def require_finite(config: Any) -> None:
    """Raise UserError if a number anywhere in a configuration is NaN or infinite."""
    for key, value in _numbers(config, ""):
        if not math.isfinite(value):
            raise UserError(f"--{key} must be a finite number, got {value}")


def _rules(hint: Any, value: Any) -> Iterator[tuple[Limits | tuple[str, ...], Any]]:
    """Yield what the type says of a value, or of those in a list: limits or words."""
    origin, arguments = typing.get_origin(hint), typing.get_args(hint)
    if origin is typing.Literal:
        yield arguments, value
    elif origin is Annotated:
        yield from ((rule, value) for rule in arguments[1:] if isinstance(rule, Limits))
    elif origin is list:
        for item in value:
            yield from _rules(arguments[0], item)
    elif origin in (typing.Union, types.UnionType) and value is not None:
        for argument in arguments:
            yield from _rules(argument, value)


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
