"""A frame as a nerfstudio scene: images, depth and labels beside ``transforms.json``.

Each frame is a static scene of its own. Camera axes are OpenGL's (x right, y up, z backwards) and matrices lead from
the camera to the world; see https://docs.nerf.studio/quickstart/data_conventions.html.
"""

from pathlib import Path

import cv2
import numpy as np
from jaxtyping import Float
from numpy import ndarray

from nerf_rl.datasets.export.picture_names import ENDING, picture_names
from nerf_rl.datasets.export.seen import Seen
from nerf_rl.datasets.storage.point_cloud import write_point_cloud
from nerf_rl.datasets.storage.reader import MultiViewDataset
from nerf_rl.datasets.storage.stored_manifest import DEPTH, LABELS
from nerf_rl.files.atomic import atomic_write
from nerf_rl.files.json_files import write_json

_METRES_PER_UNIT = 0.001  # of depth images: millimetres, nerfstudio's default
_MOST_UNITS = 65535


FARTHEST = _MOST_UNITS * _METRES_PER_UNIT
"""what depth images can hold [m]"""


def write_scene(folder: Path, seen: Seen, dataset: MultiViewDataset, masks: bool) -> int:
    """Write one frame as a scene folder, ``transforms.json`` last; return how many pixels are too far for its depth.

    There is no depth, no fused points and no labels of a dataset that lacks them.

    Args:
        folder: to make.
        seen: the frame and what of it counts.
        dataset: the frame's.
        masks: whether to write masks of the classes that count; training ignores the other pixels. Where the dataset
            has pixels that do not count, there are masks in any case.
    """
    frame, depth, kept = seen.frame, seen.depth(), seen.kept()
    has_depth, has_labels = DEPTH not in frame.absent, LABELS not in frame.absent
    entries, too_far = [], 0
    files = picture_names(dataset.camera_names)
    for view, name in enumerate(dataset.camera_names):
        images = {"file_path": ("images", frame.rgb[view][..., ::-1])}
        if has_depth:
            millimetres = np.round(depth[view] / _METRES_PER_UNIT)
            too_far += int((millimetres > _MOST_UNITS).sum())
            millimetres[millimetres > _MOST_UNITS] = 0  # too far for 16 bits: unknown
            images["depth_file_path"] = ("depths", millimetres.astype(np.uint16))
        if has_labels:
            images["semantic_path"] = ("semantics", frame.semantic[view])
        if masks or frame.valid is not None:
            images["mask_path"] = ("masks", np.where(kept[view], 255, 0).astype(np.uint8))
        entry = {}
        for key, (kind, image) in images.items():
            entry[key] = f"{kind}/{files[view]}{ENDING}"
            _write_image(folder / entry[key], image)
        K = frame.intrinsics[view]
        height, width = depth[view].shape
        entries.append(
            {
                **entry,
                "camera": name,
                "role": dataset.manifest["cameras"][view]["role"],
                "fl_x": float(K[0, 0]),
                "fl_y": float(K[1, 1]),
                "cx": float(K[0, 2]),
                "cy": float(K[1, 2]),
                "w": width,
                "h": height,
                "transform_matrix": world_from_opengl_camera(frame.camera_from_world[view]).tolist(),
            }
        )
    if has_depth:
        write_point_cloud(folder / "points.ply", seen.cloud())
    held_out = dataset.views("test")
    split = {
        "train_filenames": [entry["file_path"] for view, entry in enumerate(entries) if view not in held_out],
        "val_filenames": [entries[view]["file_path"] for view in held_out],
        "test_filenames": [entries[view]["file_path"] for view in held_out],
    }
    transforms = {
        "camera_model": "OPENCV",
        **({"depth_unit_scale_factor": _METRES_PER_UNIT, "ply_file_path": "points.ply"} if has_depth else {}),
        **(split if held_out else {}),
        **({"semantic_classes": dataset.manifest["classes"]} if has_labels else {}),
        "source": {
            "frame": frame.index,
            "episode": frame.episode,
            "step": frame.step,
            "split": frame.split,
            "dataset": dataset.digest(),
        },
        "frames": entries,
    }
    write_json(folder / "transforms.json", transforms)
    return too_far


def world_from_opengl_camera(camera_from_world: Float[ndarray, "4 4"]) -> Float[ndarray, "4 4"]:
    """Return the pose of a camera with OpenGL's axes (x right, y up, z backwards) in the world [m]."""
    return np.linalg.inv(camera_from_world) @ np.diag([1.0, -1.0, -1.0, 1.0])


def _write_image(path: Path, image: ndarray) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    _, content = cv2.imencode(ENDING, np.ascontiguousarray(image))
    with atomic_write(path) as aside:
        aside.write_bytes(content.tobytes())  # imwrite would not say why it fails
