"""From command-line arguments and recipe files to a configuration dataclass, with mistakes told in one sentence."""

import copy
import dataclasses
import functools
import itertools
import re
import typing
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from jsonargparse import ActionConfigFile, ArgumentError, ArgumentParser, set_parsing_settings

from nerf_rl.arguments.limits import require_finite
from nerf_rl.arguments.recipes import check_recipe
from nerf_rl.errors import UnknownNameError, UserError

RENAMED = {
    "radiance_field.moving_frames": "radiance_field.free_frames",
    "sampling.training_approach": "sampling.training_free_space",
    "sampling.approach_reach": "sampling.free_space_reach",
    "sharp_at": "coarse_to_fine",
    "noise.hold_share": "noise.epsilon_z",
    "noise.hold_start": "noise.epsilon_z_start",
    "noise.hold_steps": "noise.epsilon_z_steps",
    "noise.hold_kind": "noise.epsilon_z_kind",
}
"""What keys of earlier versions are called now."""
_ALONE = ("-h", "--help", "--print_config")  # keys without a value

set_parsing_settings(docstring_parse_attribute_docstrings=True)


def parse_config(config: type, program: str, description: str, arguments: Sequence[str], positional: str = "") -> Any:
    """Return an instance of the dataclass ``config``.

    Args:
        config: a dataclass; nested dataclasses become dotted keys.
        program: the name to show in help.
        description: a line for help.
        arguments: ``--config FILE`` and ``--key value`` overrides; the later one wins.
        positional: the key that a word without one stands for; none if empty.

    Raises:
        UserError: an unknown key or recipe, a wrong value, or a contradiction that the dataclass rejects.
        SystemExit: after ``--help`` and ``--print_config``.
    """
    parser = _parser(config, program, description)
    arguments = [re.sub(r"^--[^=]+", lambda key: "--" + key[0][2:].replace("-", "_"), word) for word in arguments]
    arguments = list(_name_positional(arguments, positional)) if positional else arguments
    for recipe in _recipes(arguments):
        check_recipe(Path(recipe))
    try:
        namespace = parser.instantiate(parser.parse_args(arguments))
        values = {field.name: namespace[field.name] for field in dataclasses.fields(config)}
        made = config(**values)
    except (ArgumentError, ValueError, TypeError, RecursionError, OverflowError) as error:
        raise _explain(str(error), config) from error
    require_finite(made)
    return made


def config_of(config: type, content: Mapping[str, Any]) -> Any:
    """Return an instance of the dataclass ``config`` from its keys and values, such as JSON has kept them.

    Raises:
        UserError: a key that there is not, or a wrong value.
    """
    parser = _parser(config)
    try:
        namespace = parser.instantiate(parser.parse_object(copy.deepcopy(dict(content))))
        made = config(**{field.name: namespace[field.name] for field in dataclasses.fields(config)})
    except (ArgumentError, ValueError, TypeError, RecursionError, OverflowError) as error:
        raise _explain(str(error), config) from error
    require_finite(made)
    return made


@functools.cache  # reading a dataclass's types and docstrings takes longer than parsing
def _parser(config: type, program: str = "", description: str = "") -> ArgumentParser:
    """Return the parser of a dataclass's keys; with a program, of recipes as well."""
    parser = ArgumentParser(prog=program or None, description=description, exit_on_error=False)
    if program:
        parser.add_argument("--config", action=ActionConfigFile, help="recipe (YAML); --key value overrides it")
    parser.add_class_arguments(config)
    return parser


def _recipes(arguments: Sequence[str]) -> Iterator[str]:
    """Yield the recipe files that arguments name."""
    for word, following in itertools.zip_longest(arguments, arguments[1:], fillvalue=""):
        if word == "--config":
            yield following
        elif word.startswith("--config="):
            yield word.partition("=")[2]


def _name_positional(arguments: Sequence[str], key: str) -> Iterator[str]:
    """Yield the arguments with ``--key=`` before each word that is neither a key nor the value of the key before."""
    is_value = False
    for word in arguments:
        if word.startswith("-"):
            is_value = "=" not in word and word not in _ALONE
            yield word
        else:
            yield word if is_value else f"--{key}={word}"
            is_value = False


def _explain(message: str, config: type) -> UserError:
    """Turn the parser's message into one sentence that lists what is available."""
    message = re.sub(r"\s+", " ", message).strip()
    message = re.sub(r"[Gg]roup '([^']+)' does not accept option '([^']+)'", r"Option '\1.\2' is not accepted", message)
    unknown = re.search(r"Option '([^']+)' is not accepted|[Uu]nrecognized arguments?: (?:--)?([^\s=]+)", message)
    if unknown:
        name, known = unknown.group(1) or unknown.group(2), set(_keys(config))
        if RENAMED.get(name) in known:
            return UserError(f"key '{name}' is now '{RENAMED[name]}'")
        return UnknownNameError("key", name, known)
    words = re.search(r'Parser key "([\w.]+)": Expected a typing\.Literal\[([^\]]*)\]\. Got value: (.*)', message)
    if words:
        return UnknownNameError(words[1], words[3], re.findall(r"'([^']*)'", words[2]))
    missing = re.search(r"the following arguments are required: (.+)", message)
    if missing:
        return UserError(f"missing --{missing.group(1).replace(', ', ', --')}")
    message = re.sub(r'Parser key "([^"]+)":', r"--\1:", message)
    message = re.sub(r"Expected a <class '(\w+)'>. Got value: ", r"expected \1, got ", message)
    return UserError(message[0].lower() + message[1:])


def _keys(config: type, prefix: str = "") -> Iterator[str]:
    """Yield the dotted keys of a dataclass, those of dataclasses inside lists as ``list.key``."""
    hints = typing.get_type_hints(config)
    for field in dataclasses.fields(config):
        kind = hints[field.name]
        inner = [argument for argument in (kind, *typing.get_args(kind)) if dataclasses.is_dataclass(argument)]
        if inner:
            yield from _keys(typing.cast(type, inner[0]), f"{prefix}{field.name}.")
        else:
            yield f"{prefix}{field.name}"
