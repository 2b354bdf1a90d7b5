"""What a LeRobotDataset says of itself: ``meta/info.json``, and beside it ``meta/cameras.json`` with its cameras.

The latter is what ``nerf-rl export --format lerobot`` adds, since LeRobot's format has no place for camera matrices.
"""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from nerf_rl.cameras.rig_config import MOST_CAMERAS
from nerf_rl.datasets.export.lerobot.depth_codes import DepthCodes
from nerf_rl.datasets.export.lerobot.files import CAMERAS, DATA, INFO, LABELS, VIDEO
from nerf_rl.datasets.importing.camera_matrices import camera_from_pose, checked_intrinsics
from nerf_rl.datasets.importing.faults import SourceError
from nerf_rl.datasets.importing.picture_files import MOST_PIXELS
from nerf_rl.datasets.importing.source_files import file_inside, read_description
from nerf_rl.datasets.storage.stored_manifest import LARGEST_IMAGE, MOST_CLASSES, ROLES
from nerf_rl.files.structure import array, flag, listing, mapping, number, one_of, optional, table, text, whole

VERSION = "v3."
"""what the versions of LeRobot's format begin with that are read"""
_MOST_FRAMES = 10**8
_KEY = text(r"[A-Za-z0-9_-][A-Za-z0-9_.-]*", "a name of letters, digits, points and dashes")
_SIZE = whole(1, LARGEST_IMAGE)
_FEATURE = mapping({"dtype": text(), "shape": listing(whole())}, others=True)
_INFO = mapping(
    {
        "codebase_version": text(),
        "fps": number(1e-3, 1e4),
        "total_episodes": whole(1, _MOST_FRAMES),
        "total_frames": whole(1, _MOST_FRAMES),
        "data_path": text(),
        "video_path": text(),
        "features": table(_FEATURE),
    },
    others=True,
)
_CAMERA = mapping(
    {"name": text(), "image_key": _KEY, "height": _SIZE, "width": _SIZE, "intrinsics": array(3, 3)},
    {
        "role": one_of(*ROLES),
        "depth_key": optional(_KEY),
        "world_from_camera": optional(array(4, 4)),
        "world_from_camera_key": optional(_KEY),
    },
    others=True,
)
_COLOUR = array(3, of=whole(0, 255))
_CAMERAS = mapping(
    {"cameras": listing(_CAMERA, 1, MOST_CAMERAS)},
    {
        "labels_path": text(),
        "classes": listing(mapping({"name": text(), "colour": _COLOUR}, others=True), 1, MOST_CLASSES),
    },
    others=True,
)
_DEPTH = mapping(
    {
        "video.depth_min": number(1e-6, 1e6),
        "video.depth_max": number(1e-6, 1e6),
        "video.shift": number(),
        "video.use_log": flag,
        "depth_unit": text(),
    },
    others=True,
)


@dataclass(frozen=True)
class Camera:
    """A camera and the names of what it saw."""

    name: str
    role: str | None
    image_key: str
    depth_key: str | None
    codes: DepthCodes | None
    """of its depth, if there is any"""
    intrinsics: Float[ndarray, "3 3"]
    """K [pixels]"""
    camera_from_world: Float[ndarray, "4 4"] | None
    """None if it moves"""
    pose_key: str | None
    """the feature of its pose in the world, if it moves"""


@dataclass(frozen=True)
class Description:
    """What a folder says of itself."""

    folder: Path
    fps: float
    frames: int
    episodes: int
    features: dict[str, Any]
    cameras: list[Camera]
    height: int
    """of a picture [pixels]"""
    width: int
    """of a picture [pixels]"""
    classes: list[dict[str, Any]] | None


def describe(folder: Path, scale: float) -> Description:
    """Read what a folder says of itself.

    Args:
        folder: of a LeRobotDataset.
        scale: metres in a unit of its positions.

    Raises:
        SourceError: it is damaged, of another version, or does not say where its cameras are.
    """
    path = file_inside(folder, INFO, folder / INFO)
    info = read_description(path, _INFO)
    if not info["codebase_version"].startswith(VERSION):
        raise SourceError(path, f"its version is {info['codebase_version']}, and {VERSION}x is read; convert it first")
    if (info["data_path"], info["video_path"]) != (DATA, VIDEO):
        raise SourceError(path, f"its data_path and video_path are not LeRobot's own, {DATA} and {VIDEO}")
    if not (folder / CAMERAS).is_file():
        raise SourceError(
            folder,
            f"it has no {CAMERAS}, so nothing says where its cameras are; LeRobot's format has no place for poses and "
            "intrinsics, and datasets/README.md says how that file gives them",
        )
    path = file_inside(folder, CAMERAS, folder / CAMERAS)
    content = read_description(path, _CAMERAS)
    if content.get("labels_path", LABELS) != LABELS:
        raise SourceError(path, f"its labels_path is not {LABELS}")
    entries = content["cameras"]
    sizes = {(entry["height"], entry["width"]) for entry in entries}
    if len(sizes) > 1:
        raise SourceError(path, "its cameras have pictures of different sizes")
    ((height, width),) = sizes
    if height * width > MOST_PIXELS:
        raise SourceError(path, f"{width} x {height} pixels are more than the {MOST_PIXELS} that are read")
    cameras = []
    for entry in entries:
        try:
            cameras.append(_camera(entry, info["features"], scale))
        except ValueError as error:
            raise SourceError(path, f"{error}, of {entry['name']}") from error
    if len({camera.name for camera in cameras}) < len(cameras):
        raise SourceError(path, "two cameras have one name")
    if len({camera.codes is None for camera in cameras}) > 1:
        raise SourceError(path, "some of its cameras have depth and some have none")
    counts, classes = (info["total_frames"], info["total_episodes"]), content.get("classes")
    return Description(folder, float(info["fps"]), *counts, info["features"], cameras, height, width, classes)


def _camera(entry: dict[str, Any], features: dict[str, Any], scale: float) -> Camera:
    for key in (entry["image_key"], entry.get("depth_key"), entry.get("world_from_camera_key")):
        if key is not None and key not in features:
            raise ValueError(f"it names a feature {key} that {INFO} does not have")
    pose, pose_key = entry.get("world_from_camera"), entry.get("world_from_camera_key")
    if (pose is None) == (pose_key is None):
        raise ValueError("it needs one of world_from_camera and world_from_camera_key: where the camera is")
    if pose_key is not None and features[pose_key]["shape"] != [4, 4]:
        raise ValueError(f"the feature {pose_key} is not of the shape 4 x 4")
    depth_key = entry.get("depth_key")
    return Camera(
        entry["name"],
        entry.get("role"),
        entry["image_key"],
        depth_key,
        None if depth_key is None else _codes(features[depth_key], scale),
        checked_intrinsics(np.array(entry["intrinsics"], np.float64), entry["height"], entry["width"]),
        None if pose is None else camera_from_pose(np.array(pose, np.float64), scale),
        pose_key,
    )


def _codes(feature: dict[str, Any], scale: float) -> DepthCodes:
    """Return what the codes of a depth video mean.

    Raises:
        ValueError: they mean something else than an import reads.
    """
    info = feature.get("info", {})
    _DEPTH(info, "info")
    nearest, farthest = info["video.depth_min"], info["video.depth_max"]
    if not info["video.use_log"] or info["video.shift"] != 0 or info["depth_unit"] != "m":
        raise ValueError("its depth is not in metres by the logarithm without a shift, as nerf-rl exports it")
    if not nearest < farthest:
        raise ValueError(f"its depth_min {nearest:g} is not below its depth_max {farthest:g}")
    return DepthCodes(scale * nearest, scale * farthest)
