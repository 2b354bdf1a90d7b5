"""What is exported, found and checked before anything is written: episodes, cameras, rate, instruction."""

import re
from dataclasses import dataclass
from pathlib import PurePath

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from nerf_rl.datasets.export.config import ExportConfig
from nerf_rl.datasets.export.lerobot.depth_codes import DepthCodes
from nerf_rl.datasets.export.lerobot.episodes import Episode, whole_episodes
from nerf_rl.datasets.export.lerobot.rate import steps_per_second
from nerf_rl.datasets.export.lerobot.videos import SMALLEST_DEPTH
from nerf_rl.datasets.export.seen import farthest_hit
from nerf_rl.datasets.storage.reader import MultiViewDataset
from nerf_rl.datasets.storage.stored_manifest import DEPTH, LABELS
from nerf_rl.errors import UnknownNameError, UserError
from nerf_rl.scenes.base import GYM, METAWORLD

_BLOCK_BYTES = 1 << 26


@dataclass(frozen=True)
class ExportedCamera:
    """A camera and the names of what it saw."""

    view: int
    """position on the dataset's view axis"""
    name: str
    role: str
    image_key: str
    """feature of its colours, and folder of its labels"""
    depth_key: str
    """feature of its depth"""
    pose_key: str
    """feature of its pose, if it moves"""
    intrinsics: Float[ndarray, "3 3"]
    """K [pixels]"""
    world_from_camera: Float[ndarray, "4 4"] | None
    """its pose; None if it moves"""
    codes: DepthCodes | None
    """of its depth; None if that is left out"""


@dataclass(frozen=True)
class Plan:
    """What is exported."""

    dataset: MultiViewDataset
    episodes: list[Episode]
    cameras: list[ExportedCamera]
    fps: int
    """frames a second"""
    task: str
    """instruction in words"""
    hit: float
    """planar depth from which on nothing was hit [m]"""

    @property
    def has_labels(self) -> bool:
        """Whether the dataset has any."""
        return LABELS not in self.dataset.absent

    @property
    def frames(self) -> int:
        """How many frames there will be."""
        return sum(episode.transitions for episode in self.episodes)

    @property
    def robot(self) -> str | None:
        """LeRobot's name of the robot."""
        return "metaworld" if scene_name(self.dataset).startswith(METAWORLD) else None


def make_plan(dataset: MultiViewDataset, config: ExportConfig) -> Plan:
    """Find out what there is to export.

    Raises:
        UserError: the dataset does not hold whole episodes, or has pixels that do not count, or a key asks for what
            there is not.
    """
    if config.frames or config.exclude or config.reach:
        raise UserError(
            "--format lerobot exports whole episodes as they were seen: leave out --frames, --exclude, --reach"
        )
    if dataset.read_valid([0]) is not None:
        raise UserError(
            f"{dataset.folder} has pixels that are masked or of unknown depth, for which LeRobot has no place; use "
            "--format nerfstudio"
        )
    episodes = whole_episodes(dataset, config.episodes)
    fps = config.fps or steps_per_second(scene_name(dataset))
    views = _chosen_views(dataset, config.cameras)
    keys = [_keys(dataset.camera_names[view], first=view == views[0]) for view in views]
    if len({key for of_camera in keys for key in of_camera}) < 3 * len(views):
        names = ", ".join(dataset.camera_names[view] for view in views)
        raise UserError(f"cameras {names} have names too alike for LeRobot's keys; choose some with --cameras")
    intrinsics, _ = dataset.cameras([0])
    with_depth = config.depth and DEPTH not in dataset.absent
    if with_depth and min(dataset.manifest["height"], dataset.manifest["width"]) < SMALLEST_DEPTH:
        raise UserError(f"depth as video takes {SMALLEST_DEPTH} pixels or more along each edge; use --depth false")
    hit = farthest_hit(dataset)
    codes = _depth_codes(dataset, episodes, views, hit) if with_depth else [None] * len(views)
    poses = _fixed_poses(dataset, episodes)
    roles = [camera["role"] for camera in dataset.manifest["cameras"]]
    cameras = [
        ExportedCamera(view, dataset.camera_names[view], roles[view], *key, intrinsics[view], poses[view], code)
        for view, key, code in zip(views, keys, codes, strict=True)
    ]
    return Plan(dataset, episodes, cameras, fps, config.task or _words(scene_name(dataset)), hit)


def scene_name(dataset: MultiViewDataset) -> str:
    """Return the name of a dataset's scene."""
    return str(dataset.manifest["scene"]["name"])


def blocks(frames: range, dataset: MultiViewDataset) -> list[range]:
    """Split frames into ranges whose pictures fit into memory."""
    pixels = dataset.manifest["height"] * dataset.manifest["width"] * len(dataset.camera_names)
    size = max(1, _BLOCK_BYTES // (8 * pixels))
    return [frames[first : first + size] for first in range(0, len(frames), size)]


def _chosen_views(dataset: MultiViewDataset, names: list[str]) -> list[int]:
    if not names:
        return [view for role in ("encoder", "supervision", "test") for view in dataset.views(role)]
    for name in names:
        if name not in dataset.camera_names:
            raise UnknownNameError("camera", name, dataset.camera_names)
    if len(set(names)) < len(names):
        raise UserError(f"--cameras names a camera twice: {', '.join(names)}")
    return [dataset.camera_names.index(name) for name in names]


def _keys(name: str, first: bool) -> tuple[str, str, str]:
    """Return the keys of a camera's colours, depth and pose; they become names of folders too."""
    safe = re.sub(r"[^A-Za-z0-9_.-]", "_", name)
    image = "observation.image" if first else f"observation.images.{safe}"
    return image, f"observation.images.{safe}_depth", f"camera.{safe}.world_from_camera"


def _depth_codes(dataset: MultiViewDataset, episodes: list[Episode], views: list[int], hit: float) -> list[DepthCodes]:
    nearest, farthest = np.full(len(views), np.inf), np.zeros(len(views))
    for episode in episodes:
        for block in blocks(episode.states, dataset):
            depth = dataset.read("depth", block)
            for place, view in enumerate(views):
                surface = depth[:, view][depth[:, view] < hit]
                if surface.size:
                    nearest[place] = min(nearest[place], surface.min())
                    farthest[place] = max(farthest[place], surface.max())
    seen = farthest > 0
    nearest, farthest = np.where(seen, nearest, 1.0), np.where(seen, farthest, 1.0)
    return [DepthCodes.for_range(*limits) for limits in zip(nearest.tolist(), farthest.tolist(), strict=True)]


def _fixed_poses(dataset: MultiViewDataset, episodes: list[Episode]) -> list[Float[ndarray, "4 4"] | None]:
    """Return the ``world_from_camera`` of each camera, None for those that move within or between the episodes."""
    first = dataset.cameras([episodes[0].states[0]])[1][0]
    fixed = np.ones(len(first), bool)
    for episode in episodes:
        fixed &= (dataset.cameras(episode.states)[1] == first).all(axis=(0, 2, 3))
    return [np.linalg.inv(pose) if still else None for pose, still in zip(first, fixed, strict=True)]


def _words(scene: str) -> str:
    """Return a scene's name as words: drawer open, for metaworld/drawer-open-v3."""
    if scene.startswith((METAWORLD, GYM)):
        name = scene.rpartition("/")[2].rpartition(":")[2]
    else:
        name = PurePath(scene).stem
    return re.sub(r"[-_]+", " ", re.sub(r"-v\d+$", "", name)).strip() or scene
