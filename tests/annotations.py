"""Annotations that tests check, at the price of what they say; imported before anything that is decorated.

``--jaxtyping-packages`` decorates every function with :func:`jaxtyping.jaxtyped`, which binds arguments to names and
checks them twice, so that axes of arrays are the same throughout a call. Six functions in seven have no arrays in their
signatures; beartype alone says the same of them, at a fraction of the time (checked with jaxtyping 0.3.11).

A learner's step is taken a thousand times in a test, with arrays of the same shapes each time. So a function is checked
in the first calls of each test, :data:`CHECKED_CALLS` of them, and after those in every :data:`CHECKED_CALLS`-th one.
"""

import functools
import inspect
import typing
from collections.abc import Callable
from typing import Any

import jaxtyping

CHECKED_CALLS = 100

_jaxtyped = jaxtyping.jaxtyped
_counters: list["_Counter"] = []


def jaxtyped(function: Any = None, *, typechecker: Callable[..., Any] | None = None) -> Any:
    """Decorate a function or class as jaxtyping does, without the search for axes where no annotation has any."""
    if function is None:
        return lambda decorated: jaxtyped(decorated, typechecker=typechecker)
    if typechecker is not None and inspect.isfunction(function) and not has_arrays(function):
        return _now_and_then(function, typechecker(function))
    checked = _jaxtyped(function, typechecker=typechecker)
    return _now_and_then(function, checked) if inspect.isfunction(function) else checked


def check_anew() -> None:
    """Have the next calls of every function checked, since another test begins."""
    for counter in _counters:
        counter.calls = 0


class _Counter:
    calls = 0


def _now_and_then(function: Callable[..., Any], checked: Callable[..., Any]) -> Callable[..., Any]:
    """Return a function that is the checked one in a test's first calls and now and then, else as it was written."""
    counter = _Counter()
    _counters.append(counter)

    @functools.wraps(checked)
    def call(*arguments: Any, **named: Any) -> Any:
        counter.calls += 1
        if counter.calls <= CHECKED_CALLS or counter.calls % CHECKED_CALLS == 0:
            return checked(*arguments, **named)
        return function(*arguments, **named)

    return call


def has_arrays(function: Callable[..., Any]) -> bool:
    """Return whether a function's annotations name arrays, or may, since they are strings."""
    return any(map(_names_arrays, function.__annotations__.values()))


def _names_arrays(annotation: Any) -> bool:
    if isinstance(annotation, str) or (inspect.isclass(annotation) and issubclass(annotation, jaxtyping.AbstractArray)):
        return True
    if isinstance(annotation, list | tuple):  # of arguments of a callable
        return any(map(_names_arrays, annotation))
    return typing.get_origin(annotation) is not typing.Literal and any(map(_names_arrays, typing.get_args(annotation)))


jaxtyping.jaxtyped = jaxtyped  # type: ignore[assignment]  # by this name the packages' functions are decorated
