"""Recipe files as somebody hands them in: looked at before they are turned into values.

YAML can repeat a part by a name, and parts that repeat parts grow without end; it can nest without end, too. Both are
found from the file's tokens, which take no more room than the file. The parser takes the name of a class, or of another
file, where keys are expected, and imports or reads it before it finds that it will not do; so that is found here, too.
"""

import dataclasses
import os
import typing
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import yaml
from jsonargparse import get_loader, set_loader

from nerf_rl.arguments.explanations import explain, keys_of, part_of
from nerf_rl.errors import MissingFileError, UserError

_MOST_BYTES = 1 << 20
_MOST_VALUES = 100_000
_DEEPEST = 50
_SHOWN = 60  # characters
_REMEDY = "give a YAML file such as datasets/drawer-open.yaml; --print_config shows all keys"


def check_recipe(path: Path, config: type) -> str | None:
    """Check that a file is YAML of a size that a recipe can have, with keys wherever a dataclass has keys.

    Args:
        path: the file; what is none is left to the parser.
        config: the dataclass that it is for.

    Returns:
        The text of what can be read only once, such as a pipe, and is not left for the parser; else None.

    Raises:
        MissingFileError: it is not.
        UserError: a key that there is not.
    """
    if not path.exists() or path.is_dir():
        return None
    try:
        text = _read(path)
        _count(text)
        content = yaml.safe_load(text)
        if isinstance(content, dict) and "config" in content:
            raise ValueError("it has a key 'config', which is for arguments: give each recipe by a --config of its own")
        if isinstance(content, dict):
            require_keys(content, config)
        elif not path.is_file():
            raise ValueError("there are no keys in it")
    except (OSError, ValueError, RecursionError, yaml.YAMLError) as error:
        raise MissingFileError("a recipe", path, str(error) or "it cannot be read", _REMEDY) from error
    return None if path.is_file() else text


def check_part(part: str, given: str, config: type) -> str | None:
    """Check what the command line gives for a part that is made of keys: a file of them, or the keys themselves.

    Words in the place of keys are refused. What else may be wrong is left to the parser.

    Args:
        part: its dotted key.
        given: a file's path, or YAML.
        config: the dataclass that it is of.

    Returns:
        As :func:`check_recipe`.

    Raises:
        UserError: the file cannot be read, a key that there is not, or words in the place of keys.
    """
    is_file = os.path.exists(given) and not os.path.isdir(given)  # of a name that is too long as well
    try:
        text = _read(Path(given)) if is_file else given
        _count(text)
        content = yaml.safe_load(text)
    except (OSError, ValueError, RecursionError, yaml.YAMLError) as error:
        told = " ".join(str(error).split())
        raise UserError(f"{given} cannot be read: {told}" if is_file else f"--{part}: {told}") from error
    for name, value, _ in _parts({part: content}, config, ""):
        if isinstance(value, str):
            what = "keys, or a file of them" if name == part else "keys"
            raise UserError(f"--{name}: expected {what}, got {value[:_SHOWN]}")
    _require_known({part: content}, config)
    return text if is_file and not os.path.isfile(given) else None


def is_part(key: str, config: type) -> bool:
    """Return whether a dotted key names a part of a dataclass that is made of keys, or a list or dictionary of such."""
    first, rest = _first_of(key)
    hint = typing.get_type_hints(config).get(first)
    part = part_of(hint)
    if part is not None and rest and typing.get_origin(hint) is dict:
        rest = rest.partition(".")[2]  # after the name of a member
    return part is not None and (not rest or is_part(rest, part))


def require_keys(content: Mapping[Any, Any], config: type) -> None:
    """Check that a dataclass's parts, which are dataclasses, and lists and dictionaries of them, are made of keys.

    Args:
        content: by keys, or by dotted ones.
        config: the dataclass.

    Raises:
        UserError: a key that there is not.
        ValueError: something else in the place of keys.
    """
    for name, value, part in _parts(content, config, ""):
        if not isinstance(value, Mapping):
            raise ValueError(f"{name} must be keys ({', '.join(keys_of(part))}), got {str(value)[:_SHOWN]!r}")
    _require_known(content, config)


def _require_known(content: Mapping[Any, Any], config: type) -> None:
    """Raise UserError for a key that a part does not have."""
    for name, value, part in _parts(content, config, ""):
        known = {field.name for field in dataclasses.fields(part)}
        for key in value if isinstance(value, Mapping) else ():
            if _first_of(key)[0] not in known:
                raise explain(f"Option '{name}.{key}' is not accepted", config)


def _read(path: Path) -> str:
    """Return a file's text; raise OSError or ValueError if it cannot be a recipe's."""
    with open(path, "rb") as file:
        read = file.read(_MOST_BYTES + 1)
    if len(read) > _MOST_BYTES:
        raise ValueError(f"it is larger than {_MOST_BYTES} bytes")
    return read.decode("utf-8")


def _parts(content: Mapping[Any, Any], config: type, prefix: str) -> Iterator[tuple[str, Any, type]]:
    """Yield the dotted name of each part, what stands there, and the dataclass that it is to be; None is left out."""
    hints = typing.get_type_hints(config)
    for key, value in content.items():
        first, rest = _first_of(key)
        hint = hints.get(first)
        part = part_of(hint)
        if part is None or value is None:
            continue
        given = {rest: value} if rest else value
        if typing.get_origin(hint) is dict and isinstance(given, Mapping):
            members = list(given.values())
        else:
            members = given if typing.get_origin(hint) is list and isinstance(given, list) else [given]
        name = f"{prefix}{first}"
        for member in members:
            yield name, member, part
            if isinstance(member, Mapping):
                yield from _parts(member, part, f"{name}.")


def _first_of(key: Any) -> tuple[str, str]:
    """Return the first part of a dotted key, without the sign that adds to a list, and the rest."""
    first, _, rest = str(key).partition(".")
    return first.removesuffix("+"), rest


def check_all_that_is_read() -> None:
    """Let the parser refuse, wherever it reads YAML from now on, what grows or nests without end; to be called once."""
    load = get_loader("yaml")

    def load_checked(text: str) -> Any:
        _count(text)
        return load(text)

    set_loader("yaml", load_checked, (ValueError, yaml.YAMLError))


def _count(text: str) -> None:
    """Raise ValueError if a YAML text, with its repetitions written out, nests too deeply or has too many values."""
    sizes: dict[str, int] = {}
    open_parts: list[tuple[str | None, int]] = []  # of each its name, and how many values there were before it
    values = 0
    for event in yaml.parse(text, yaml.SafeLoader):
        if isinstance(event, yaml.AliasEvent):
            if any(name == event.anchor for name, _ in open_parts):
                raise ValueError(f"'{event.anchor}' repeats itself")
            values += sizes.get(str(event.anchor), 1)
        elif isinstance(event, yaml.NodeEvent):
            values += 1
            if isinstance(event, yaml.CollectionStartEvent):
                open_parts.append((event.anchor, values - 1))
            elif event.anchor:
                sizes[event.anchor] = 1
        elif isinstance(event, yaml.CollectionEndEvent):
            name, before = open_parts.pop()
            if name:
                sizes[name] = values - before
        if len(open_parts) > _DEEPEST:
            raise ValueError(f"it is nested more than {_DEEPEST} deep")
        if values > _MOST_VALUES:
            raise ValueError(f"it has more than {_MOST_VALUES} values")
