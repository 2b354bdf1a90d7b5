"""Annotations that tests check, at the price of what they say; imported before anything that is decorated.

``--jaxtyping-packages`` decorates every function with :func:`jaxtyping.jaxtyped`, which binds arguments to names and
checks them twice, so that axes of arrays are the same throughout a call. Six functions in seven have no arrays in their
signatures; beartype alone says the same of them, at a fraction of the time (checked with jaxtyping 0.3.11).
"""

import inspect
import typing
from collections.abc import Callable
from typing import Any

import jaxtyping

_jaxtyped = jaxtyping.jaxtyped


def jaxtyped(function: Any = None, *, typechecker: Callable[..., Any] | None = None) -> Any:
    """Decorate a function or class as jaxtyping does, without the search for axes where no annotation has any."""
    if function is None:
        return lambda decorated: jaxtyped(decorated, typechecker=typechecker)
    if typechecker is not None and inspect.isfunction(function) and not has_arrays(function):
        return typechecker(function)
    return _jaxtyped(function, typechecker=typechecker)


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
