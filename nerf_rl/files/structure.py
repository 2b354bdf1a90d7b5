"""What a JSON description must look like, said once as data: a checker for each value, put together to that of a file.

A checker takes a value and where it stands (``rig.intrinsics.0``), and raises :class:`StructureError` if it is not what
belongs there. Numbers are bounded by what any run could mean, so that none of them makes a reader allocate without end.
"""

import re
import sys
from collections.abc import Callable, Mapping
from typing import Any

MOST = 2**31 - 1  # of a count, unless something smaller is said
_SHOWN = 60  # characters of a wrong value

Checker = Callable[[Any, str], None]
"""Raises StructureError unless the value, which stands at the place, is as expected."""


class StructureError(ValueError):
    """A value that is not what belongs in its place."""

    def __init__(self, place: str, value: Any, expected: str):
        if isinstance(value, dict | list):
            shown = "a mapping" if isinstance(value, dict) else f"a list of {len(value)}"
        else:
            shown = repr(value)[: _SHOWN + 1]
        shown = shown if len(shown) <= _SHOWN else f"{shown[:_SHOWN]}..."
        super().__init__(f"{place or 'the whole'} is {shown} instead of {expected}")


def whole(least: int = 0, most: int = MOST) -> Checker:
    """Return a checker of whole numbers."""

    def check(value: Any, place: str) -> None:
        if isinstance(value, bool) or not isinstance(value, int) or not least <= value <= most:
            raise StructureError(place, value, f"a whole number from {least} to {most}")

    return check


def any_number(value: Any, place: str) -> None:
    """Check that a value is a finite number of any size."""
    number(-sys.float_info.max, sys.float_info.max)(value, place)


def number(least: float = -1e12, most: float = 1e12) -> Checker:
    """Return a checker of finite numbers."""

    def check(value: Any, place: str) -> None:
        if isinstance(value, bool) or not isinstance(value, (int, float)) or not least <= value <= most:
            raise StructureError(place, value, f"a number from {least:g} to {most:g}")

    return check


def flag(value: Any, place: str) -> None:
    """Check that a value is true or false."""
    if not isinstance(value, bool):
        raise StructureError(place, value, "true or false")


def text(pattern: str = "", meaning: str = "") -> Checker:
    """Return a checker of texts that match a regular expression from end to end.

    Args:
        pattern: none for any text.
        meaning: what matches, in words.
    """

    def check(value: Any, place: str) -> None:
        if not isinstance(value, str) or (pattern and re.fullmatch(pattern, value, re.ASCII) is None):
            raise StructureError(place, value, meaning or "a text")
        if not value.isprintable():
            raise StructureError(place, value, "a text of printable characters")

    return check


def one_of(*values: str) -> Checker:
    """Return a checker of words."""

    def check(value: Any, place: str) -> None:
        if not isinstance(value, str) or value not in values:
            raise StructureError(place, value, f"one of {', '.join(values)}")

    return check


def optional(checker: Checker) -> Checker:
    """Return a checker that lets null pass as well."""

    def check(value: Any, place: str) -> None:
        if value is not None:
            checker(value, place)

    return check


def listing(item: Checker, least: int = 0, most: int = MOST) -> Checker:
    """Return a checker of lists with so many items."""

    def check(value: Any, place: str) -> None:
        if not isinstance(value, list) or not least <= len(value) <= most:
            length = f"{least}" if least == most else f"{least} or more" if most == MOST else f"{least} to {most}"
            raise StructureError(place, value, f"a list of {length}")
        for index, entry in enumerate(value):
            item(entry, _below(place, str(index)))

    return check


def array(*shape: int, of: Checker | None = None) -> Checker:
    """Return a checker of nested lists of numbers; -1 stands for any length but none."""
    item = of or number()
    for length in reversed(shape):
        item = listing(item, 1, MOST) if length < 0 else listing(item, length, length)
    return item


def mapping(
    required: Mapping[str, Checker], optional: Mapping[str, Checker] | None = None, others: bool = False
) -> Checker:
    """Return a checker of mappings.

    Args:
        required: the keys that there must be.
        optional: those that may be there.
        others: whether further keys may be there; they are not looked at.
    """
    known = {**required, **(optional or {})}

    def check(value: Any, place: str) -> None:
        if not isinstance(value, dict):
            raise StructureError(place, value, f"a mapping with {', '.join(required) or 'named values'}")
        missing = next((key for key in required if key not in value), None)
        if missing is not None:
            raise StructureError(place, value, f"one with {missing}, which is missing")
        for key, entry in value.items():
            if key in known:
                known[key](entry, _below(place, key))
            elif not others:
                raise StructureError(_below(place, str(key)), entry, f"nothing: known are {', '.join(known)}")

    return check


def table(value: Checker) -> Checker:
    """Return a checker of mappings from any name to values of one kind."""

    def check(content: Any, place: str) -> None:
        if not isinstance(content, dict):
            raise StructureError(place, content, "a mapping")
        for key, entry in content.items():
            value(entry, _below(place, str(key)))

    return check


def _below(place: str, key: str) -> str:
    return f"{place}.{key}" if place else key
