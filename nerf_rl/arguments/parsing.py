"""From command-line arguments and recipe files to a configuration dataclass, with mistakes told in one sentence."""

import copy
import dataclasses
import functools
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from jsonargparse import ActionConfigFile, ArgumentError, ArgumentParser, Namespace, set_parsing_settings

from nerf_rl.arguments.explanations import explain
from nerf_rl.arguments.limits import require_finite
from nerf_rl.arguments.recipes import check_all_that_is_read, check_part, check_recipe, is_part, require_keys
from nerf_rl.errors import UserError

_NEGATIVE_NUMBER = re.compile(r"-(\d+\.?\d*|\.\d+)(e[-+]?\d+)?", re.IGNORECASE)
_ALONE = ("-h", "--help", "--print_config")  # keys without a value

set_parsing_settings(docstring_parse_attribute_docstrings=True)
check_all_that_is_read()


def parse_config(config: type, program: str, description: str, arguments: Sequence[str], positional: str = "") -> Any:
    """Return an instance of the dataclass ``config``.

    Args:
        config: a dataclass; nested dataclasses become dotted keys.
        program: the name to show in help.
        description: a line for help.
        arguments: ``--config FILE``, and ``--key value``, which overrides recipes wherever it stands; of several
            recipes, and of one key twice, the later one wins.
        positional: the key that a word without one stands for; none if empty.

    Raises:
        UserError: an unknown key or recipe, a wrong value, or a contradiction that the dataclass rejects.
        SystemExit: after ``--help`` and ``--print_config``.
    """
    parser = _parser(config, program, description)
    arguments = [re.sub(r"^--[^=]+", lambda key: "--" + key[0][2:].replace("-", "_"), word) for word in arguments]
    arguments = _join_negative_numbers(arguments)
    arguments = list(_name_positional(arguments, positional)) if positional else arguments
    arguments = sorted(_check_recipes(arguments, config), key=lambda word: not word.startswith("--config="))
    return _made(config, parser, lambda: parser.parse_args(arguments))


def config_of(config: type, content: Mapping[str, Any]) -> Any:
    """Return an instance of the dataclass ``config`` from its keys and values, such as JSON has kept them.

    Raises:
        UserError: a key that there is not, or a wrong value.
    """
    parser = _parser(config)

    def parse() -> Namespace:
        require_keys(content, config)
        return parser.parse_object(copy.deepcopy(dict(content)))

    return _made(config, parser, parse)


def _made(config: type, parser: ArgumentParser, parse: Callable[[], Namespace]) -> Any:
    """Return an instance of a dataclass from what a parser makes of its keys; errors are explained."""
    try:
        namespace = parser.instantiate(parse())
        made = config(**{field.name: namespace[field.name] for field in dataclasses.fields(config)})
    except (ArgumentError, ValueError, TypeError, RecursionError, OverflowError) as error:
        raise explain(str(error), config) from error
    require_finite(made)
    return made


@functools.cache  # reading a dataclass's types and docstrings takes longer than parsing
def _parser(config: type, program: str = "", description: str = "") -> ArgumentParser:
    """Return the parser of a dataclass's keys; with a program, of recipes as well."""
    parser = ArgumentParser(prog=program or None, description=description, exit_on_error=False, allow_abbrev=False)
    if program:
        parser.add_argument("--config", action=ActionConfigFile, help="recipe (YAML); --key value overrides it")
    parser.add_class_arguments(config)
    return parser


def _join_negative_numbers(arguments: Sequence[str]) -> list[str]:
    """Return the arguments with ``--key=-1e-05`` in place of two words: argparse takes such a number for a key."""
    joined: list[str] = []
    for word in arguments:
        if joined and joined[-1].startswith("--") and "=" not in joined[-1] and _NEGATIVE_NUMBER.fullmatch(word):
            joined[-1] += f"={word}"
        else:
            joined.append(word)
    return joined


def _check_recipes(arguments: Sequence[str], config: type) -> Iterator[str]:
    """Yield the arguments, once each recipe and each part of one is checked.

    In place of a file that can be read only once stands its text.
    """
    words = iter(arguments)
    for word in words:
        key, is_joined, value = word.removeprefix("--").partition("=")
        if not word.startswith("--") or not (key == "config" or is_part(key, config)):
            yield word
            continue
        given = value if is_joined else next(words, None)
        if given is None:
            yield word
            continue
        text = check_recipe(Path(given), config) if key == "config" else check_part(key, given, config)
        yield f"--{key}={given if text is None else text}"  # joined, since a text may begin with a hyphen


def _name_positional(arguments: Sequence[str], key: str) -> Iterator[str]:
    """Yield the arguments with ``--key=`` before each word that is neither a key nor the value of the key before.

    Raises:
        UserError: there are several, and the key is no list to which each is appended.
    """
    is_value, taken = False, ""
    for word in arguments:
        if word.startswith("-"):
            is_value = "=" not in word and word not in _ALONE
            yield word
        elif is_value:
            yield word
            is_value = False
        else:
            if taken and not key.endswith("+"):
                raise UserError(f"one {key} is taken, got {taken} and {word}")
            yield f"--{key}={word}"
            taken = word
