"""JSON files that carry a checksum of themselves, so that any changed byte of them is found."""

import hashlib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from nerf_rl.files.atomic import write_text
from nerf_rl.files.json_files import json_text, parse_json

CHECKSUM = "checksum"


def with_checksum(content: Mapping[str, Any]) -> dict[str, Any]:
    """Return the content with the SHA-256 of its JSON text under ``checksum``, in place of one that it may have."""
    body = {key: value for key, value in content.items() if key != CHECKSUM}
    return {**body, CHECKSUM: hashlib.sha256(json_text(body).encode()).hexdigest()}


def write_checksummed(path: Path, content: Mapping[str, Any]) -> None:
    """Write a mapping with its checksum as JSON, whole or not at all."""
    write_text(path, json_text(with_checksum(content)))


def is_whole(path: Path) -> bool:
    """Tell whether a file has, to the byte, what :func:`write_checksummed` writes."""
    try:
        text = path.read_bytes()
        content = parse_json(text)
        return isinstance(content, dict) and json_text(with_checksum(content)).encode() == text
    except (OSError, ValueError, RecursionError):
        return False
