"""JSON files that carry a checksum of themselves, so that any changed byte of them is found."""

import hashlib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from nerf_rl.runs import json_text, parse_json, write_text

CHECKSUM = "checksum"


def sealed(content: Mapping[str, Any]) -> dict[str, Any]:
    """Return the content with the SHA-256 of its JSON text under ``checksum``, in place of one that it may have."""
    body = {key: value for key, value in content.items() if key != CHECKSUM}
    return {**body, CHECKSUM: hashlib.sha256(json_text(body).encode()).hexdigest()}


def write_sealed(path: Path, content: Mapping[str, Any]) -> None:
    """Write a mapping with its checksum as JSON, whole or not at all."""
    write_text(path, json_text(sealed(content)))


def is_whole(path: Path) -> bool:
    """Tell whether a file has, to the byte, what :func:`write_sealed` writes."""
    try:
        text = path.read_bytes()
        content = parse_json(text)
        return isinstance(content, dict) and json_text(sealed(content)).encode() == text
    except (OSError, ValueError, RecursionError):
        return False
