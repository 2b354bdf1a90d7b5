"""JSON without NaN and infinity, written whole or not at all."""

import json
from pathlib import Path
from typing import Any

from nerf_rl.files.atomic import write_text


def write_json(path: Path, content: Any) -> None:
    """Write JSON whole or not at all; numbers that JSON has no word for (NaN, infinity) are an error."""
    write_text(path, json_text(content))


def json_text(content: Any) -> str:
    """Return what :func:`write_json` writes; the same content gives the same text."""
    return json.dumps(content, indent=2, allow_nan=False) + "\n"


def read_json(path: Path) -> Any:
    """Read a JSON file.

    Raises:
        OSError: it cannot be read.
        ValueError: it holds something else, or numbers that JSON has no word for.
    """
    return parse_json(path.read_bytes())


def parse_json(content: bytes) -> Any:
    """Return what JSON in UTF-8 says; raise ValueError for anything else, and for lists nested without end."""
    try:
        return json.loads(content.decode(), parse_constant=_refuse_constant)
    except RecursionError as error:
        raise ValueError("it is nested too deeply") from error


def _refuse_constant(name: str) -> None:
    raise ValueError(f"it holds {name}, which is no JSON")
