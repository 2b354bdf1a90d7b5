"""Optional dependencies: imported where they are used, with a sentence that names the extra to install."""

import importlib
from collections.abc import Callable
from types import ModuleType
from typing import Any

from nerf_rl.errors import UserError


def import_extra(module: str, extra: str, purpose: str) -> ModuleType:
    """Import a module that only the extra ``extra`` installs.

    Args:
        module: to import.
        extra: name of the extra in ``pyproject.toml``.
        purpose: what needs it, as the beginning of a sentence.

    Raises:
        UserError: it is not installed.
    """
    try:
        return importlib.import_module(module)
    except ModuleNotFoundError as error:
        if error.name is None or error.name.split(".")[0] != module.split(".")[0]:
            raise  # a dependency of the module is missing: another extra would not help
        raise UserError(
            f"{purpose} needs the extra '{extra}'; in a checkout of nerf-rl: pip install '.[{extra}]'"
        ) from error


def find_named(kind: str, name: str) -> Any:
    """Return a class of the user's own.

    Args:
        kind: what it is to be, for messages.
        name: ``module:Class``.

    Raises:
        UserError: the module cannot be imported, or has no such class.
    """
    module, _, attribute = name.partition(":")
    return _told(kind, name, lambda: getattr(importlib.import_module(module), attribute))


def make_named(kind: str, name: str, *arguments: Any) -> Any:
    """Return what a class of the user's own makes of some arguments; raise UserError if there is none or it fails."""
    made = find_named(kind, name)
    return _told(kind, name, lambda: made(*arguments))


def _told(kind: str, name: str, get: Callable[[], Any]) -> Any:
    try:
        return get()
    except Exception as error:  # a user's code may raise anything
        reason = " ".join(str(error).split())
        raise UserError(f"{kind} '{name}' cannot be had: {type(error).__name__}: {reason}") from error
