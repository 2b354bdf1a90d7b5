"""Shards that are whole, whoever made them: what is known of each, and what a manifest says of them."""

import json
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any, NamedTuple

import h5py

from nerf_rl.datasets.storage.plan import Plan, plan_digest
from nerf_rl.datasets.storage.shards import sha256_of, shard_file, shard_path
from nerf_rl.errors import UserError

_PLAN, _SCENE, _RENDERER = "plan", "scene", "renderer"  # attributes of a shard's file
_AND = " and "  # between the renderers that a manifest names


class FinishedShard(NamedTuple):
    """What is known of a finished shard."""

    shard: int
    frames: int
    sha256: str
    """of the file"""
    renderer: str
    """the OpenGL implementation that made it"""
    peak_rss_mb: float = 0.0
    """most memory that the process which made it has held [MB]"""


def shard_attributes(plan: Plan, scene: Mapping[str, Any], renderer: str) -> dict[str, str]:
    """Return what a shard's file says of itself, by which it is known again.

    Args:
        plan: that the dataset was begun with.
        scene: the scene's provenance.
        renderer: the OpenGL implementation that makes the shard.
    """
    return {_PLAN: plan_digest(plan), _SCENE: json.dumps(scene), _RENDERER: renderer}


def finished_shard(folder: Path, shard: int, frames: int, scene: Mapping[str, Any], plan: Plan) -> FinishedShard | None:
    """Return what is known of a shard on disk, or None if it is missing or of another configuration.

    Args:
        folder: of the dataset.
        shard: its number.
        frames: how many it has to have.
        scene: the scene's provenance.
        plan: that the dataset was begun with.

    Raises:
        UserError: it is of another version of the scene; a model that changed since, or another MuJoCo, would render
            otherwise.
    """
    path, expected = shard_path(folder, shard), shard_attributes(plan, scene, "")
    try:
        with h5py.File(path, "r") as file:
            if file.attrs[_PLAN] != expected[_PLAN] or len(file["rgb"]) != frames:
                return None
            renderer, made_of = file.attrs[_RENDERER], json.loads(file.attrs[_SCENE])
            other = sorted(key for key in {*made_of, *scene} if made_of.get(key) != scene.get(key))
    except (OSError, KeyError, ValueError, TypeError):
        return None
    if other:
        raise UserError(
            f"{path} is of another version of the scene (what differs: {', '.join(other)}), and would be made anew; "
            "restore that version, or use --overwrite true or another --out"
        )
    return FinishedShard(shard, frames, sha256_of(path), renderer)


def shard_entry(shard: FinishedShard) -> dict[str, Any]:
    """Return what a manifest says of a shard."""
    return {"file": shard_file(shard.shard), "frames": shard.frames, "sha256": shard.sha256}


def with_shards(
    description: Mapping[str, Any], shards: Iterable[Mapping[str, Any]], renderers: Iterable[str]
) -> dict[str, Any]:
    """Return a whole manifest.

    Args:
        description: what it says that does not depend on the shards.
        shards: ``file``, ``frames`` and ``sha256`` of each, in any order.
        renderers: the OpenGL implementations that made them.
    """
    entries = sorted(shards, key=lambda entry: entry["file"])
    return {
        **description,
        "renderer": _AND.join(sorted(set(renderers))),
        "frames": sum(entry["frames"] for entry in entries),
        "shards": entries,
    }


def renderers_in(named: str) -> list[str]:
    """Return the OpenGL implementations that a manifest's ``renderer`` names; none of one without shards."""
    return [name for name in named.split(_AND) if name]
