"""``transforms.json`` of a nerfstudio scene: which pictures it names, and where their cameras were.

See https://docs.nerf.studio/quickstart/data_conventions.html. ``camera``, ``role``, ``semantic_path``,
``semantic_classes`` and ``source`` are what ``nerf-rl export`` adds; other programs' scenes do without.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path, PurePosixPath
from typing import Any

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from nerf_rl.cameras.rig_config import MOST_CAMERAS
from nerf_rl.datasets.importing.camera_matrices import camera_from_opengl_pose, checked_intrinsics
from nerf_rl.datasets.importing.faults import SourceError
from nerf_rl.datasets.importing.nerfstudio.lens import COEFFICIENTS, Lens
from nerf_rl.datasets.importing.picture_files import MOST_PIXELS, picture_size
from nerf_rl.datasets.importing.source_files import file_inside, read_description
from nerf_rl.datasets.storage.shards import SPLIT_NAMES
from nerf_rl.datasets.storage.stored_manifest import LARGEST_IMAGE, MOST_CLASSES, ROLES
from nerf_rl.files.structure import MOST, array, flag, listing, mapping, number, one_of, text, whole

TRANSFORMS = "transforms.json"
_PINHOLES = ("OPENCV", "PINHOLE", "SIMPLE_PINHOLE", "SIMPLE_RADIAL", "RADIAL")
_USUAL_UNIT = 0.001  # of depth: millimetres
_FILES = {"depth": "depth_file_path", "labels": "semantic_path", "mask": "mask_path"}
_CAMERA = dict.fromkeys(("fl_x", "fl_y", "cx", "cy", "w", "h", *COEFFICIENTS), number())
_CAMERA |= {"camera_model": text(), "is_fisheye": flag, "depth_unit_scale_factor": number(1e-9, 1e6)}
_HELD_OUT = ("val_filenames", "test_filenames")
_COLOUR = array(3, of=whole(0, 255))

_STRUCTURE = mapping(
    {
        "frames": listing(
            mapping(
                {"file_path": text(), "transform_matrix": array(4, 4)},
                {**_CAMERA, **dict.fromkeys(_FILES.values(), text()), "camera": text(), "role": one_of(*ROLES)},
                others=True,
            ),
            1,
            MOST_CAMERAS,
        )
    },
    {
        **_CAMERA,
        **dict.fromkeys(_HELD_OUT, listing(text())),
        "semantic_classes": listing(mapping({"name": text(), "colour": _COLOUR}), 1, MOST_CLASSES),
        "source": mapping(
            {},
            {
                **dict.fromkeys(("frame", "episode", "step"), whole(0, MOST)),
                "split": one_of(*SPLIT_NAMES),
                "dataset": text(),
            },
            others=True,
        ),
    },
    others=True,
)


@dataclass(frozen=True)
class View:
    """A picture and the camera that took it."""

    name: str
    """of the camera: as the scene says, else the file's without its ending"""
    role: str | None
    """if the scene says it"""
    colours: Path
    others: Mapping[str, Path]
    """files of ``depth``, ``labels`` and ``mask``, those that there are"""
    height: int
    """[pixels]"""
    width: int
    """[pixels]"""
    intrinsics: Float[ndarray, "3 3"]
    """K [pixels]"""
    lens: Lens | None
    """what bends the picture; None for a pinhole"""
    camera_from_world: Float[ndarray, "4 4"]
    unit: float
    """of its depth [units of positions]"""


@dataclass(frozen=True)
class Scene:
    """A moment in time, seen by several cameras."""

    path: Path
    """of its ``transforms.json``"""
    views: list[View]
    """by name"""
    classes: list[dict[str, Any]] | None
    source: Mapping[str, Any]
    """``frame``, ``episode``, ``step``, ``split`` and ``dataset`` of what was exported, as far as they are known"""


def read_scene(folder: Path, scale: float) -> Scene:
    """Read the description of a scene.

    Args:
        folder: of the scene; no file outside of it is read.
        scale: metres in a unit of its positions.

    Raises:
        SourceError: the description is damaged, leads elsewhere, or is of cameras that an import cannot take.
    """
    path = file_inside(folder, TRANSFORMS, folder / TRANSFORMS)
    content = read_description(path, _STRUCTURE)
    shared = {key: content[key] for key in _CAMERA if key in content}
    held_out = {PurePosixPath(name) for key in _HELD_OUT for name in content.get(key, ())}
    views = []
    for entry in content["frames"]:
        try:
            views.append(_view(folder, path, {**shared, **entry}, held_out, scale))
        except ValueError as error:
            raise SourceError(path, f"{error}, of {entry['file_path'][:200]}") from error
    views.sort(key=lambda view: view.name)
    twice = next((a.name for a, b in pairwise(views) if a.name == b.name), None)
    if twice is not None:
        raise SourceError(path, f"it has two pictures of a camera {twice}")
    return Scene(path, views, content.get("semantic_classes"), content.get("source", {}))


def _view(folder: Path, path: Path, entry: Mapping[str, Any], held_out: set[PurePosixPath], scale: float) -> View:
    """Return a view from its keys and those that all views of the scene share."""
    model = entry.get("camera_model", _PINHOLES[0])
    if model not in _PINHOLES:
        raise ValueError(
            f"its camera model is {model}, and only pictures of pinhole cameras ({_PINHOLES[0]}) are taken"
        )
    if entry.get("is_fisheye"):  # as instant-ngp marks it
        raise ValueError(f"it is marked is_fisheye, and only pictures of pinhole cameras ({_PINHOLES[0]}) are taken")
    colours = file_inside(folder, entry["file_path"], path)
    height, width = _whole(entry, "h"), _whole(entry, "w")
    if height is None or width is None:
        height, width = picture_size(colours)
    if height * width > MOST_PIXELS:
        raise ValueError(f"{width} x {height} pixels are more than the {MOST_PIXELS} that are read")
    missing = [key for key in ("fl_x", "fl_y", "cx", "cy") if key not in entry]
    if missing:
        raise ValueError(f"it gives no {', '.join(missing)}")
    K = np.array([[entry["fl_x"], 0.0, entry["cx"]], [0.0, entry["fl_y"], entry["cy"]], [0.0, 0.0, 1.0]])
    role = "test" if PurePosixPath(entry["file_path"]) in held_out else entry.get("role")
    return View(
        entry.get("camera") or colours.stem,
        role,
        colours,
        {kind: file_inside(folder, entry[key], path) for kind, key in _FILES.items() if key in entry},
        height,
        width,
        checked_intrinsics(K, height, width),
        Lens.of({key: float(entry.get(key, 0.0)) for key in COEFFICIENTS}),
        camera_from_opengl_pose(np.array(entry["transform_matrix"], np.float64), scale),
        float(entry.get("depth_unit_scale_factor", _USUAL_UNIT)),
    )


def _whole(entry: Mapping[str, Any], key: str) -> int | None:
    """Return a number of pixels, which some programs write as 640.0."""
    value = entry.get(key)
    if value is None:
        return None
    if value != int(value) or not 1 <= value <= LARGEST_IMAGE:
        raise ValueError(f"{key} is {value} instead of a whole number from 1 to {LARGEST_IMAGE}")
    return int(value)
