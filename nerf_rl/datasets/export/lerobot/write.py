"""A LeRobotDataset, written file by file; ``meta/info.json``, without which LeRobot takes it for none, comes last."""

from pathlib import Path
from typing import Any

import numpy as np

from nerf_rl.datasets.export.lerobot import files
from nerf_rl.datasets.export.lerobot.features import columns, described
from nerf_rl.datasets.export.lerobot.part import open_part
from nerf_rl.datasets.export.lerobot.plan import ExportedCamera, Plan, scene_name
from nerf_rl.datasets.export.lerobot.statistics import together
from nerf_rl.datasets.export.lerobot.tables import write_rows, write_tasks
from nerf_rl.files.json_files import write_json
from nerf_rl.progress import Progress

VERSION = "v3.0"
"""of LeRobot's format"""


def write_dataset(folder: Path, plan: Plan) -> None:
    """Write all episodes of a plan to an empty folder."""
    rows: list[dict[str, Any]] = []
    number = first = 0
    with Progress(plan.frames, "frames") as progress:
        while len(rows) < len(plan.episodes):
            with open_part(folder, plan, number) as part:
                while len(rows) < len(plan.episodes) and part.has_room(plan.episodes[len(rows)]):
                    episode = plan.episodes[len(rows)]
                    rows.append(part.add(len(rows), episode, first))
                    first += episode.transitions
                    progress.advance(episode.transitions)
            number += 1
    write_rows(files.file_path(folder, files.EPISODES, 0), rows)
    write_tasks(folder / files.TASKS, [plan.task])
    write_json(folder / files.STATS, _statistics(rows))
    write_json(folder / files.CAMERAS, _cameras(plan))
    write_json(folder / files.INFO, _info(plan))


def _info(plan: Plan) -> dict[str, Any]:
    return {
        "codebase_version": VERSION,
        "robot_type": plan.robot,
        "total_episodes": len(plan.episodes),
        "total_frames": plan.frames,
        "total_tasks": 1,
        "chunks_size": files.CHUNK,
        "data_files_size_in_mb": files.MOST_DATA_MB,
        "video_files_size_in_mb": files.MOST_VIDEO_MB,
        "fps": plan.fps,
        "splits": {"train": f"0:{len(plan.episodes)}"},
        "data_path": files.DATA,
        "video_path": files.VIDEO,
        "features": described(plan, columns(plan, 0, plan.episodes[0], 0)),
    }


def _statistics(rows: list[dict[str, Any]]) -> dict[str, Any]:
    """Return the statistics of the dataset, from those in the rows of its episodes."""
    prefix = "stats/"
    names = [name.removeprefix(prefix).rpartition("/") for name in rows[0] if name.startswith(prefix)]
    found = {}
    for key in dict.fromkeys(key for key, _, _ in names):
        own = [name for of, _, name in names if of == key]
        parts = [{name: np.array(row[f"{prefix}{key}/{name}"]) for name in own} for row in rows]
        found[key] = {name: value.tolist() for name, value in together(parts).items()}
    return found


def _cameras(plan: Plan) -> dict[str, Any]:
    """Return ``meta/cameras.json``: what LeRobot's format has no place for."""
    classes = [{"id": i, **entry} for i, entry in enumerate(plan.dataset.manifest["classes"])]
    return {
        "convention": {
            "camera_axes": "OpenCV: x right, y down, z forward",
            "world": "MuJoCo's, in metres",
            "pixels": "column i, row j covers [i, i + 1) x [j, j + 1): its centre is (i + 0.5, j + 0.5)",
            "intrinsics": "K, 3x3 [pixels]",
            "world_from_camera": "4x4, rows first: takes points of the camera to points of the world",
            "depth": "planar: z in the camera's frame [m]; depth_max is where nothing was hit",
        },
        "cameras": [_camera(plan, camera) for camera in plan.cameras],
        **({"labels_path": files.LABELS, "classes": classes} if plan.has_labels else {}),
        "source": {"scene": scene_name(plan.dataset), "dataset": plan.dataset.digest()},
    }


def _camera(plan: Plan, camera: ExportedCamera) -> dict[str, Any]:
    fixed = camera.world_from_camera
    return {
        "name": camera.name,
        "role": camera.role,
        "image_key": camera.image_key,
        "depth_key": camera.depth_key if camera.codes is not None else None,
        "height": plan.dataset.manifest["height"],
        "width": plan.dataset.manifest["width"],
        "intrinsics": camera.intrinsics.tolist(),
        "world_from_camera": None if fixed is None else fixed.tolist(),
        "world_from_camera_key": camera.pose_key if fixed is None else None,
    }
