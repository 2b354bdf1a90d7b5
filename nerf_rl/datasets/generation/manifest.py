"""What a manifest says of a dataset."""

import json
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import h5py

from nerf_rl.datasets.config import GenDatasetConfig
from nerf_rl.datasets.generation.shard_episodes import (
    PLAN_ATTRIBUTE,
    RENDERER_ATTRIBUTE,
    SCENE_ATTRIBUTE,
    RenderContext,
    RenderedShard,
    shard_episodes,
)
from nerf_rl.datasets.storage.plan import Plan, plan_digest
from nerf_rl.datasets.storage.shards import SCHEMA_VERSION, sha256_of, shard_file, shard_path
from nerf_rl.files.versions import package_versions
from nerf_rl.rendering.semantics import palette
from nerf_rl.scenes.state_columns import joints


def describe(config: GenDatasetConfig, context: RenderContext, plan: Plan) -> dict[str, Any]:
    """Return what a manifest says that does not depend on the shards.

    Args:
        config: of the dataset.
        context: that renders it.
        plan: that the dataset was begun with.
    """
    names = context.classes.names
    scene, rig = context.scene, context.rig
    action_names = [f"action_{i}" for i in range(context.layout["state/action"][0][0])]
    return {
        "schema_version": SCHEMA_VERSION,
        "config": plan,
        "scene": scene.provenance(),
        "packages": package_versions(),
        "height": config.size,
        "width": config.size,
        "far": context.renderer.far,
        "detail": context.renderer.detail,
        "cameras": [{"name": name, "role": role} for name, role in zip(rig.names, rig.roles, strict=True)],
        "classes": [
            {"name": name, "colour": colour.tolist()} for name, colour in zip(names, palette(len(names)), strict=True)
        ],
        "columns": {
            "proprio": list(scene.proprio_names),
            "privileged": list(scene.privileged_names),
            "action": action_names,
        },
        "joints": joints(scene.model),
        "bodies": [scene.model.body(i).name for i in range(scene.model.nbody)],
        **({} if rig.tracking_frame is None else {"tracking_frame": rig.tracking_frame.to_json()}),
    }


def with_shards(
    description: Mapping[str, Any], shards: Iterable[Mapping[str, Any]], renderers: Iterable[str]
) -> dict[str, Any]:
    """Return a whole manifest.

    Args:
        description: of :func:`describe`.
        shards: ``file``, ``frames`` and ``sha256`` of each, in any order.
        renderers: the OpenGL implementations that made them.
    """
    entries = sorted(shards, key=lambda entry: entry["file"])
    return {
        **description,
        "renderer": " and ".join(sorted(set(renderers))),
        "frames": sum(entry["frames"] for entry in entries),
        "shards": entries,
    }


def shard_entry(shard: RenderedShard) -> dict[str, Any]:
    """Return what a manifest says of a shard."""
    return {"file": shard_file(shard.shard), "frames": shard.frames, "sha256": shard.sha256}


def finished_shard(
    folder: Path, config: GenDatasetConfig, shard: int, scene: Mapping[str, Any], plan: Plan
) -> RenderedShard | None:
    """Return what is known of a shard on disk, or None if it is missing or of another configuration or scene.

    Args:
        folder: of the dataset.
        config: of the dataset.
        shard: its number.
        scene: the scene's provenance; a model that changed since, or another MuJoCo, would render otherwise.
        plan: that the dataset was begun with.
    """
    path, frames = shard_path(folder, shard), len(shard_episodes(config, shard)) * config.frames_per_episode
    try:
        with h5py.File(path, "r") as file:
            made_of = file.attrs[PLAN_ATTRIBUTE], file.attrs[SCENE_ATTRIBUTE]
            if made_of != (plan_digest(plan), json.dumps(scene)) or len(file["rgb"]) != frames:
                return None
            renderer = file.attrs[RENDERER_ATTRIBUTE]
    except (OSError, KeyError):
        return None
    return RenderedShard(shard, frames, sha256_of(path), renderer)
