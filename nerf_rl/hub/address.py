"""Addresses on the Hugging Face Hub: ``hf://USER/NAME`` and ``hf://USER/NAME@REVISION``."""

import re
from dataclasses import dataclass
from pathlib import Path

from nerf_rl.errors import UserError

SCHEME = "hf://"
_NAME = r"[A-Za-z0-9][\w.-]*"
_REVISION = r"[A-Za-z0-9][\w.-]*(?:/[A-Za-z0-9][\w.-]*)*"
_ADDRESS = re.compile(rf"({_NAME}/{_NAME})(?:@({_REVISION}))?", re.ASCII)
_BEGINS = re.compile(r"hf:/+")  # pathlib makes one slash of two


@dataclass(frozen=True)
class Address:
    """A repository, or one of its revisions."""

    repository: str
    """user or organisation, a slash, and its name"""
    revision: str = ""
    """branch, tag or commit; the main branch if empty"""

    def __str__(self) -> str:
        return SCHEME + self.repository + (f"@{self.revision}" if self.revision else "")


def is_address(path: Path | str) -> bool:
    """Tell whether something is meant as an address on the Hub and not as a path."""
    return _BEGINS.match(str(path)) is not None


def parse_address(text: Path | str) -> Address:
    """Return the address that a text says, with or without ``hf://`` before it.

    Raises:
        UserError: it is none.
    """
    matched = _ADDRESS.fullmatch(_BEGINS.sub("", str(text), count=1))
    if matched is None or ".." in matched[0]:
        form = f"{SCHEME}USER/NAME or {SCHEME}USER/NAME@REVISION"
        raise UserError(f"'{text}' is no address on the Hugging Face Hub; expected {form}")
    return Address(matched[1], matched[2] or "")
