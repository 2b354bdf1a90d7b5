"""What decides a dataset's content, as it was written down when the dataset was begun.

A dataset that an earlier version began keeps its plan to the end, with the keys that there were then: its shards carry
the plan's digest, so that only with it they come out byte for byte the same.
"""

import hashlib
import json
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from nerf_rl.arguments.stored_keys import with_defaults
from nerf_rl.datasets.config import GenDatasetConfig
from nerf_rl.files.json_files import read_json
from nerf_rl.files.outputs import plain

PLAN = "plan.json"

Plan = dict[str, Any]
"""The keys that decide the content, and their values."""


def plan_of(config: GenDatasetConfig) -> Plan:
    """Return the plan of a dataset that is begun now."""
    return plain(config.content())


def plan_digest(plan: Plan) -> str:
    """Return the SHA-256 of a plan; each shard carries it."""
    return hashlib.sha256(json.dumps(plan).encode()).hexdigest()


def same_content(first: Any, second: Any) -> bool:
    """Tell whether two plans make the same dataset: a key that one does not have yet counts as its default."""
    return with_defaults(first, GenDatasetConfig) == with_defaults(second, GenDatasetConfig)


def begun_plan(paths: Iterable[Path], plan: Plan) -> Plan | None:
    """Return the plan that a dataset was begun with.

    Args:
        paths: where it may have been written down.
        plan: today's.

    Returns:
        The first that is there, today's if none is; None if one of them makes another dataset.
    """
    stored = [_read(path) for path in paths if path.is_file()]
    if not all(same_content(other, plan) for other in stored):
        return None
    return stored[0] if stored else plan


def _read(path: Path) -> Any:
    try:
        return read_json(path)
    except (OSError, ValueError):
        return None
