"""Making one shard: act its episodes, render frames at random steps, write them. Runs in a worker process."""

import functools
import itertools
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import NamedTuple

import mujoco
import numpy as np
from jaxtyping import Float
from numpy import ndarray

from nerf_rl.cameras.geometry import projection_matrix
from nerf_rl.datasets.config import GenDatasetConfig
from nerf_rl.datasets.generation.behaviours import Behaviour
from nerf_rl.datasets.storage.finished_shards import FinishedShard, shard_attributes
from nerf_rl.datasets.storage.frame_checks import array_faults, view_faults
from nerf_rl.datasets.storage.plan import Plan
from nerf_rl.datasets.storage.shards import TRAIN, VALIDATION, Layout, ShardWriter, frame_layout, sha256_of, shard_path
from nerf_rl.datasets.storage.splits import validation_episodes
from nerf_rl.errors import FailureError
from nerf_rl.machine.memory import peak_rss_mb
from nerf_rl.rendering.renderer import MultiViewRenderer
from nerf_rl.rendering.rigs import Rig, make_rig
from nerf_rl.rendering.semantics import SemanticClasses, semantic_classes
from nerf_rl.scenes.base import Scene
from nerf_rl.scenes.make import make_scene


class RenderContext(NamedTuple):
    """Everything a worker process needs and makes once."""

    scene: Scene
    model: mujoco.MjModel
    """that the scene's states are drawn by, which the others are made for"""
    behaviour: Behaviour
    renderer: MultiViewRenderer
    rig: Rig
    still_poses: Float[ndarray, "V 4 4"] | None
    """of all cameras, if none of them moves"""
    classes: SemanticClasses
    layout: Layout


def open_render_context(config: GenDatasetConfig) -> RenderContext:
    """Build the scene, the renderer and what describes them; raises UserError for names that do not exist."""
    scene = make_scene(config.scene)
    rig = make_rig(config.rig, config.size, scene)
    model = scene.drawn_model
    behaviour = Behaviour(scene, config.behaviour, config.episode_steps)
    classes = semantic_classes(model, scene.parts, config.classes, config.robot_links)
    pixels_per_metre = rig.pixels_per_metre(scene.render_data())
    renderer = MultiViewRenderer(model, config.size, config.size, len(rig.names), config.quality, pixels_per_metre)
    columns = {
        "proprio": len(scene.proprio_names),
        "privileged": len(scene.privileged_names),
        "action": int(np.prod(scene.env.action_space.shape or ())),
    }
    sizes = {"nq": model.nq, "nv": model.nv, "nbody": model.nbody, "nmocap": model.nmocap}
    layout = frame_layout(len(rig.names), config.size, rig.moving, sizes, columns, rig.tracking_frame is not None)
    still_poses = None if rig.moving else rig.poses(scene.render_data(), np.random.default_rng())
    return RenderContext(scene, model, behaviour, renderer, rig, still_poses, classes, layout)


def shard_count(config: GenDatasetConfig) -> int:
    """Return the number of shards of a dataset."""
    return -(-config.episodes // config.episodes_per_shard)


def shard_episodes(config: GenDatasetConfig, shard: int) -> range:
    """Return the episodes of a shard."""
    first = shard * config.episodes_per_shard
    return range(first, min(first + config.episodes_per_shard, config.episodes))


def shard_frames(config: GenDatasetConfig, shard: int) -> int:
    """Return the number of frames of a shard."""
    return len(shard_episodes(config, shard)) * config.frames_per_episode


def render_shard(config: GenDatasetConfig, shard: int, beat: Callable[[], None], plan: Plan) -> FinishedShard:
    """Write a shard. Its content depends on the configuration and its seed alone.

    Args:
        config: of the dataset.
        shard: its number.
        beat: called after each frame.
        plan: that the dataset was begun with.

    Raises:
        FailureError: a frame is unusable.
    """
    context = _render_context(_FrozenConfig(config))
    beat()
    held_out = validation_episodes(config.episodes, config.validation_fraction, config.seed)
    episodes = shard_episodes(config, shard)
    constant = {"cameras/intrinsics": context.rig.intrinsics}
    if context.still_poses is not None:
        constant["cameras/camera_from_world"] = context.still_poses
        constant["cameras/projection"] = projection_matrix(context.rig.intrinsics, context.still_poses)
    frames = shard_frames(config, shard)
    renderer = context.renderer.gl_renderer
    attributes = shard_attributes(plan, context.scene.provenance(), renderer)
    path = shard_path(Path(config.out), shard)
    with ShardWriter(path, frames, context.layout, constant, attributes) as writer:
        for episode in episodes:
            split = VALIDATION if episode in held_out else TRAIN
            rows = []
            for row in render_episode(context, config, episode, split):
                rows.append(row)
                beat()
            writer.append({name: np.stack([row[name] for row in rows]) for name in context.layout})
    return FinishedShard(shard, frames, sha256_of(path), renderer, peak_rss_mb())


def render_episode(
    context: RenderContext, config: GenDatasetConfig, episode: int, split: int
) -> Iterable[dict[str, ndarray]]:
    """Yield the rows of an episode's frames as they are rendered.

    Raises:
        FailureError: a view shows nothing, a number is not finite, or the scene has another model than before or moves
            a camera that is fixed.
    """
    scene, rng = context.scene, np.random.default_rng([config.seed, episode])
    kept = set(rng.choice(config.episode_steps + 1, config.frames_per_episode, replace=False).tolist())
    steps = itertools.islice(context.behaviour.act(episode, rng), max(kept) + 1)
    for place, now in enumerate(steps):
        if place not in kept:
            continue
        if scene.drawn_model is not context.model:
            raise FailureError(
                f"{scene.name} compiles a model of other parts in episode {episode}, and a dataset is of one; let its "
                "resets change values alone, such as places, sizes and colours"
            )
        shown = scene.render_data()
        poses = context.rig.poses(shown, rng)
        if context.still_poses is not None and not np.array_equal(poses, context.still_poses):
            moved = context.rig.names[int((poses != context.still_poses).any((1, 2)).argmax())]
            raise FailureError(
                f"{scene.name} moves camera {moved} of its model, which stood elsewhere than in episode {episode} when "
                "the scene was made; leave that camera out, let resets leave it alone, or fix it to a body that moves"
            )
        views = context.renderer.render(shown, context.rig.intrinsics, poses)
        model, data = scene.model, scene.data
        row = {
            "rgb": views.rgb,
            "depth": views.depth,
            "semantic": context.classes.label(views.geom),
            "episode": np.array(episode),
            "step": np.array(now.step),
            "split": np.array(split),
            "state/qpos": data.qpos.copy(),
            "state/qvel": data.qvel.copy(),
            "state/mocap_pos": data.mocap_pos.copy(),
            "state/mocap_quat": data.mocap_quat.copy(),
            "state/body_pos": model.body_pos.copy(),
            "state/body_quat": model.body_quat.copy(),
            "state/proprio": scene.proprio(now.observation),
            "state/privileged": scene.privileged(now.observation),
            "state/action": now.action,
            "reward": np.array(now.reward),
            "success": np.array(now.success),
        }
        row |= {name: now.stored[name] for name in row if name in now.stored}
        if context.rig.moving:
            row["cameras/camera_from_world"] = poses
            row["cameras/projection"] = projection_matrix(context.rig.intrinsics, poses)
        if context.rig.tracking_frame is not None:
            row["cameras/tracking_origin"] = context.rig.origin(shown)
        faults = [
            *(f"camera {context.rig.names[view]} {fault}" for (view,), fault in view_faults(views.rgb, views.depth)),
            *(f"{name} {fault}" for name, values in row.items() for fault in array_faults(values)),
        ]
        if faults:
            raise FailureError(f"episode {episode}, step {now.step}: {faults[0]}; no such frame is kept")
        yield row


class _FrozenConfig:
    """A configuration that compares by its content, to key the cache of one context a process."""

    def __init__(self, config: GenDatasetConfig):
        self.config, self._content = config, repr(config.content())

    def __hash__(self) -> int:
        return hash(self._content)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, _FrozenConfig) and other._content == self._content


@functools.lru_cache(maxsize=1)
def _render_context(frozen: _FrozenConfig) -> RenderContext:
    return open_render_context(frozen.config)
