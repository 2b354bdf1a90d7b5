"""What the doctor says of one thing."""

from dataclasses import dataclass


@dataclass(frozen=True)
class Finding:
    """One thing that was looked at."""

    name: str
    status: str
    """``ok``, ``note`` (worth knowing, not needed for most work) or ``broken`` (needed)"""
    detail: str
    fix: str = ""
    """what to do, in a line; empty if all is well"""


def shortened(text: str, most: int = 160) -> str:
    """Return a message cut off after so many letters."""
    return text if len(text) <= most else f"{text[: most - 1]}…"
