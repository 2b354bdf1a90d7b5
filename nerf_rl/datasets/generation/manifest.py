"""What a manifest says of a generated dataset."""

from typing import Any

from nerf_rl.datasets.config import GenDatasetConfig
from nerf_rl.datasets.generation.shard_episodes import RenderContext
from nerf_rl.datasets.storage.plan import Plan
from nerf_rl.datasets.storage.shards import SCHEMA_VERSION
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
        "detail": context.renderer.pixels_per_metre,
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
