"""What an import makes of a source, decided before the first picture is read: roles, splits, sizes, plan, manifest."""

import math
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from nerf_rl.cameras.geometry import projection_matrix
from nerf_rl.datasets.importing.camera_matrices import shrunk_intrinsics
from nerf_rl.datasets.importing.config import USUAL_VALIDATION_FRACTION, ImportConfig
from nerf_rl.datasets.importing.source import Source
from nerf_rl.datasets.storage.plan import Plan
from nerf_rl.datasets.storage.shards import SCHEMA_VERSION, SPLIT_NAMES, VALIDATION, Layout, frame_layout
from nerf_rl.datasets.storage.splits import validation_episodes
from nerf_rl.datasets.storage.stored_manifest import EPISODE_FRAMES, IMPORTED_FROM, frames_of_shard
from nerf_rl.errors import UnknownNameError, UserError
from nerf_rl.files.outputs import plain
from nerf_rl.files.versions import package_versions
from nerf_rl.scenes.imported import IMPORTED

MOST_PIXELS = 1 << 27
"""of all views of a frame, as they are stored"""
_SHOWN_DIGITS = 12  # of a source's digest, in its name


@dataclass(frozen=True)
class Content:
    """What is imported."""

    source: Source
    config: ImportConfig
    roles: list[str]
    """of the cameras"""
    held_out: frozenset[int]
    """episodes for validation"""

    @property
    def far(self) -> float:
        """Depth where nothing was hit [m]."""
        return self.config.far

    @property
    def shrink(self) -> int:
        """How many times smaller pictures become."""
        return self.config.shrink

    @property
    def size(self) -> tuple[int, int]:
        """Height and width of a stored picture [pixels]."""
        return self.source.height // self.shrink, self.source.width // self.shrink

    @cached_property
    def intrinsics(self) -> Float[ndarray, "V 3 3"]:
        """K of the stored pictures [pixels]."""
        return shrunk_intrinsics(self.source.intrinsics, self.shrink)

    @cached_property
    def plan(self) -> Plan:
        """What decides the content."""
        counts = {EPISODE_FRAMES: [episode.frames for episode in self.source.episodes]}
        source = {IMPORTED_FROM: self.source.format, "source_sha256": self.source.digest}
        return plain({**source, **self.config.content(), **counts})

    @property
    def scene(self) -> dict[str, Any]:
        """What the manifest and the shards name in place of a scene."""
        return {"name": f"{IMPORTED}{self.source.format}-{self.source.digest[:_SHOWN_DIGITS]}"}

    def shard_frames(self) -> dict[int, int]:
        """Return how many frames each shard has, by its number."""
        shards = math.ceil(len(self.source.episodes) / self.config.episodes_per_shard)
        return {shard: frames_of_shard(self.plan, shard) for shard in range(shards)}

    def shard_episodes(self, shard: int) -> range:
        """Return the episodes of a shard."""
        first = shard * self.config.episodes_per_shard
        return range(first, min(first + self.config.episodes_per_shard, len(self.source.episodes)))

    def layout(self) -> Layout:
        """Return the arrays of a shard that have one row a frame."""
        source = self.source
        columns = {group: len(names) for group, names in source.columns.items()}
        moving = source.camera_from_world is None
        return frame_layout(len(self.roles), self.size, moving, None, columns, valid=source.has_invalid)

    def constant(self) -> dict[str, ndarray]:
        """Return the arrays of a shard that are the same for all frames."""
        poses = self.source.camera_from_world
        cameras = {"cameras/intrinsics": self.intrinsics}
        if poses is None:
            return cameras
        projection = projection_matrix(self.intrinsics, poses)
        return {**cameras, "cameras/camera_from_world": poses, "cameras/projection": projection}

    def describe(self) -> dict[str, Any]:
        """Return what a manifest says that does not depend on the shards."""
        source, (height, width) = self.source, self.size
        return {
            "schema_version": SCHEMA_VERSION,
            "config": self.plan,
            "scene": self.scene,
            "packages": package_versions(),
            "height": height,
            "width": width,
            "far": self.far,
            "cameras": [
                {"name": name, "role": role} for name, role in zip(source.camera_names, self.roles, strict=True)
            ],
            "classes": source.classes,
            "columns": source.columns,
            "absent": list(source.absent),
        }


def decide_content(source: Source, config: ImportConfig) -> Content:
    """Return what an import makes of a source.

    Raises:
        UserError: there is no such camera, no camera for the encoder, or pictures are too small or too large.
    """
    content = Content(source, config, _roles(source, config), _held_out(source, config))
    height, width = content.size
    if min(height, width) < 1:
        raise UserError(
            f"--shrink {config.shrink} leaves nothing of pictures of {source.width} x {source.height} pixels"
        )
    if len(content.roles) * height * width > MOST_PIXELS:
        raise UserError(
            f"{len(content.roles)} views of {width} x {height} pixels are more than the {MOST_PIXELS} pixels that a "
            "frame may have; raise --shrink"
        )
    return content


def _roles(source: Source, config: ImportConfig) -> list[str]:
    """Return the role of each camera: what is asked for, else what the source says, else what the cameras allow."""
    for name in (*config.encoder, *config.test):
        if name not in source.camera_names:
            raise UnknownNameError("camera", name, source.camera_names)
    roles = dict(source.roles)
    if config.test:
        roles = {name: "supervision" if role == "test" else role for name, role in roles.items()}
    if config.encoder:
        roles = {name: "supervision" if role == "encoder" else role for name, role in roles.items()}
    roles |= dict.fromkeys(config.encoder, "encoder") | dict.fromkeys(config.test, "test")
    if "encoder" not in roles.values():
        # a test camera that the source names may be all that stands still, and cameras that all move are refused later
        free = [name for name in source.camera_names if roles.get(name, "encoder") == "encoder"]
        roles |= dict.fromkeys([name for name in free if name in source.still] or free, "encoder")
    if "encoder" not in roles.values():
        raise UserError(f"{config.source} leaves no camera to the encoder; name some with --encoder")
    return [roles.get(name, "supervision") for name in source.camera_names]


def _held_out(source: Source, config: ImportConfig) -> frozenset[int]:
    splits = [episode.split for episode in source.episodes]
    if config.validation_fraction is None and None not in splits:
        return frozenset(np.flatnonzero([split == SPLIT_NAMES[VALIDATION] for split in splits]).tolist())
    fraction = USUAL_VALIDATION_FRACTION if config.validation_fraction is None else config.validation_fraction
    return validation_episodes(len(splits), fraction, config.seed)
