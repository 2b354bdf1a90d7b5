"""Making one shard: act its episodes, render frames at random steps, write them. Runs in a worker process."""

import functools
import itertools
import signal
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy import ndarray

from nerf_rl.cameras import projection_matrix
from nerf_rl.datasets.behaviours import Behaviour
from nerf_rl.datasets.config import GenDatasetConfig
from nerf_rl.datasets.renderer import MultiViewRenderer
from nerf_rl.datasets.rigs import Rig, make_rig
from nerf_rl.datasets.scenes import Scene, make_scene
from nerf_rl.datasets.semantics import SemanticClasses, semantic_classes
from nerf_rl.datasets.shards import SHARDS, TRAIN, VALIDATION, Layout, ShardWriter, frame_layout
from nerf_rl.gl import use_one_software_thread


class Studio(NamedTuple):
    """Everything a worker process needs and makes once."""

    scene: Scene
    behaviour: Behaviour
    renderer: MultiViewRenderer
    rig: Rig
    classes: SemanticClasses
    layout: Layout


def open_studio(config: GenDatasetConfig) -> Studio:
    """Build the scene, the renderer and what describes them; raises UserError for names that do not exist."""
    scene = make_scene(config.scene)
    rig = make_rig(config.rig, config.size, scene)
    model = scene.model
    behaviour = Behaviour(scene, config.behaviour, config.episode_steps)
    classes = semantic_classes(model, scene.parts, config.classes)
    detail = rig.detail(scene.shown())
    renderer = MultiViewRenderer(model, config.size, config.size, len(rig.names), config.quality, detail)
    columns = {
        "proprio": len(scene.proprio_names),
        "privileged": len(scene.privileged_names),
        "action": int(np.prod(scene.env.action_space.shape or ())),
    }
    sizes = {"nq": model.nq, "nv": model.nv, "nbody": model.nbody, "nmocap": model.nmocap}
    layout = frame_layout(len(rig.names), config.size, rig.moving, sizes, columns)
    return Studio(scene, behaviour, renderer, rig, classes, layout)


def start_worker() -> None:
    """Prepare a worker process: one core each, and interruptions are the parent's business."""
    use_one_software_thread()
    signal.signal(signal.SIGINT, signal.SIG_IGN)


def shard_path(folder: Path, shard: int) -> Path:
    """Return where a shard is written."""
    return folder / SHARDS / f"{shard:06d}.h5"


def shard_episodes(config: GenDatasetConfig, shard: int) -> range:
    """Return the episodes of a shard."""
    first = shard * config.episodes_per_shard
    return range(first, min(first + config.episodes_per_shard, config.episodes))


def validation_episodes(config: GenDatasetConfig) -> frozenset[int]:
    """Return the episodes held out for validation: at least one if any are asked for and there are two."""
    count = round(config.validation_fraction * config.episodes)
    if config.validation_fraction > 0 and config.episodes > 1:
        count = min(max(count, 1), config.episodes - 1)
    order = np.random.default_rng([config.seed, 2**32]).permutation(config.episodes)
    return frozenset(int(episode) for episode in order[:count])


def render_shard(config: GenDatasetConfig, shard: int) -> int:
    """Write a shard; return its number of frames. The content depends on the configuration and its seed alone."""
    studio = _studio(_FrozenConfig(config))
    held_out = validation_episodes(config)
    episodes = shard_episodes(config, shard)
    constant = {"cameras/intrinsics": studio.rig.intrinsics}
    if not studio.rig.moving:
        poses = studio.rig.poses(studio.scene.shown(), np.random.default_rng())
        constant["cameras/camera_from_world"] = poses
        constant["cameras/projection"] = projection_matrix(studio.rig.intrinsics, poses)
    frames = len(episodes) * config.frames_per_episode
    with ShardWriter(shard_path(Path(config.out), shard), frames, studio.layout, constant) as writer:
        for episode in episodes:
            rows = _render_episode(studio, config, episode, VALIDATION if episode in held_out else TRAIN)
            writer.append({name: np.stack([row[name] for row in rows]) for name in studio.layout})
    return frames


def _render_episode(studio: Studio, config: GenDatasetConfig, episode: int, split: int) -> list[dict[str, ndarray]]:
    scene, rng = studio.scene, np.random.default_rng([config.seed, episode])
    kept = set(rng.choice(config.episode_steps + 1, config.frames_per_episode, replace=False).tolist())
    rows = []
    moments = itertools.islice(studio.behaviour.act(episode, rng), max(kept) + 1)
    for place, moment in enumerate(moments):
        if place not in kept:
            continue
        shown = scene.shown()
        poses = studio.rig.poses(shown, rng)
        views = studio.renderer.render(shown, studio.rig.intrinsics, poses)
        if (views.rgb == views.rgb[:, :1, :1]).all():
            raise RuntimeError(f"episode {episode}, step {moment.step}: every view is of a single colour")
        model, data = scene.model, scene.data
        row = {
            "rgb": views.rgb,
            "depth": views.depth,
            "semantic": studio.classes.label(views.geom),
            "episode": np.array(episode),
            "step": np.array(moment.step),
            "split": np.array(split),
            "state/qpos": data.qpos.copy(),
            "state/qvel": data.qvel.copy(),
            "state/mocap_pos": data.mocap_pos.copy(),
            "state/mocap_quat": data.mocap_quat.copy(),
            "state/body_pos": model.body_pos.copy(),
            "state/body_quat": model.body_quat.copy(),
            "state/proprio": scene.proprio(moment.observation),
            "state/privileged": scene.privileged(moment.observation),
            "state/action": moment.action,
            "reward": np.array(moment.reward),
            "success": np.array(moment.success),
        }
        row |= {name: moment.stored[name] for name in row if name in moment.stored}
        if studio.rig.moving:
            row["cameras/camera_from_world"] = poses
            row["cameras/projection"] = projection_matrix(studio.rig.intrinsics, poses)
        rows.append(row)
    return rows


class _FrozenConfig:
    """A configuration that compares by its content, to key the cache of one studio a process."""

    def __init__(self, config: GenDatasetConfig):
        self.config, self._content = config, repr(config.content())

    def __hash__(self) -> int:
        return hash(self._content)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, _FrozenConfig) and other._content == self._content


@functools.lru_cache(maxsize=1)
def _studio(frozen: _FrozenConfig) -> Studio:
    return open_studio(frozen.config)
