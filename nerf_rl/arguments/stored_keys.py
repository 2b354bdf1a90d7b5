"""Configurations that an earlier version stored: a key that it did not have yet counts as today's default."""

import dataclasses
import types
import typing
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import yaml

from nerf_rl.errors import UserError
from nerf_rl.files.outputs import plain


def with_defaults(stored: Any, config: type) -> Any:
    """Return a stored configuration with the keys that it lacks, at all depths.

    Args:
        stored: as YAML or JSON has kept it.
        config: the dataclass of its keys; those of dataclasses in lists and mappings are filled in as well.
    """
    if not isinstance(stored, Mapping):
        return stored
    hints, complete = typing.get_type_hints(config), dict(stored)
    for field in dataclasses.fields(config):
        if field.name in stored:
            complete[field.name] = _value_with_defaults(stored[field.name], hints[field.name])
        elif field.default is not dataclasses.MISSING:
            complete[field.name] = plain(field.default)
        elif field.default_factory is not dataclasses.MISSING:
            complete[field.name] = plain(field.default_factory())
    return complete


def _value_with_defaults(value: Any, hint: Any) -> Any:
    """Return a stored value of a key with this type."""
    if dataclasses.is_dataclass(hint):
        return with_defaults(value, typing.cast(type, hint))
    origin, arguments = typing.get_origin(hint), typing.get_args(hint)
    if origin in (typing.Union, types.UnionType):
        inner = [argument for argument in arguments if dataclasses.is_dataclass(argument)]
        return _value_with_defaults(value, inner[0]) if inner else value
    if origin is list and isinstance(value, list):
        return [_value_with_defaults(item, arguments[0]) for item in value]
    if origin is dict and isinstance(value, Mapping):
        return {key: _value_with_defaults(item, arguments[1]) for key, item in value.items()}
    return value


def require_same_keys(folder: Path, content: Mapping[str, Any], config: type) -> None:
    """Check that a run to be resumed was begun with the same keys.

    Args:
        folder: of the run; its ``config.yaml`` is compared.
        content: the keys that must not change.
        config: the dataclass of all keys.

    Raises:
        UserError: some differ, and the message names them; or ``config.yaml`` is damaged.
    """
    try:
        stored = yaml.safe_load((folder / "config.yaml").read_text(encoding="utf-8"))
        if not isinstance(stored, dict):
            raise ValueError("it holds no keys")
    except (OSError, ValueError, RecursionError, yaml.YAMLError) as error:
        raise UserError(
            f"{folder / 'config.yaml'} is damaged, so that nothing tells what the run was begun with; "
            "use --overwrite true or another --out"
        ) from error
    complete = with_defaults(stored, config)
    other = [key for key, value in plain(dict(content)).items() if complete.get(key) != value]
    if other:
        raise UserError(
            f"{folder} was begun with another --{', --'.join(other)}; resume with the same or use another --out"
        )
