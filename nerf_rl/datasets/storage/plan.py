"""What decides a dataset's content, as it was written down when the dataset was begun.

A dataset that an earlier version began keeps its plan to the end, with the keys that there were then: its shards carry
the plan's digest, so that only with it they come out byte for byte the same.
"""

import hashlib
import json
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

from nerf_rl.arguments.stored_keys import with_defaults
from nerf_rl.datasets.config import GenDatasetConfig
from nerf_rl.datasets.storage.reader import MultiViewDataset
from nerf_rl.datasets.storage.shards import MANIFEST, sha256_of
from nerf_rl.files.json_files import read_json
from nerf_rl.files.outputs import plain

PLAN = "plan.json"

_STATES_SHA256 = "states_sha256"  # of a plan: what the source of states held; not a key of the command

Plan = dict[str, Any]
"""The keys that decide the content, and their values; and the digest of the states that are replayed, if there are."""


def plan_of(config: GenDatasetConfig) -> Plan:
    """Return the plan of a dataset that is begun now.

    Raises:
        UserError: the source of the states that it replays is a damaged dataset.
    """
    states = config.behaviour.states
    digest = _states_digest(Path(states)) if states else None
    return {**plain(config.content()), **({} if digest is None else {_STATES_SHA256: digest})}


def command_keys(plan: Mapping[str, Any]) -> Plan:
    """Return the keys of the command that a plan holds."""
    return {key: value for key, value in plan.items() if key != _STATES_SHA256}


def plan_digest(plan: Plan) -> str:
    """Return the SHA-256 of a plan; each shard carries it."""
    return hashlib.sha256(json.dumps(plan).encode()).hexdigest()


def same_content(first: Any, second: Any) -> bool:
    """Tell whether two plans make the same dataset.

    A key that one does not have yet counts as its default, and a digest of states as what the other one has.
    """
    first, second = _comparable(first, second)
    return bool(first == second)


def different_keys(paths: Iterable[Path], plan: Plan) -> list[str]:
    """Return the names of what plans that were written down have otherwise than today's, for :func:`same_content`."""
    found = set()
    for path in paths:
        stored, today = _comparable(_read(path) if path.is_file() else plan, plan)
        if isinstance(stored, Mapping):
            found |= {key for key in stored.keys() | today.keys() if stored.get(key) != today.get(key)}
    return sorted(found)


def _comparable(first: Any, second: Any) -> list[Any]:
    """Return two plans with all keys that there are now, and with digests of states if both have one."""
    plans = [with_defaults(plan, GenDatasetConfig) for plan in (first, second)]
    if not all(isinstance(plan, Mapping) and _STATES_SHA256 in plan for plan in plans):
        plans = [command_keys(plan) if isinstance(plan, Mapping) else plan for plan in plans]
    return plans


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


def _states_digest(source: Path) -> str | None:
    """Return what identifies the content of a source of states; None if it cannot be read, which opening it will tell.

    Raises:
        UserError: the source is a damaged dataset.
    """
    if (source / MANIFEST).is_file():
        return MultiViewDataset(source).digest()
    try:
        return sha256_of(source)
    except OSError:
        return None


def _read(path: Path) -> Any:
    try:
        return read_json(path)
    except (OSError, ValueError):
        return None
