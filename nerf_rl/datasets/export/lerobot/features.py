"""What ``meta/info.json`` says of each feature: its type, shape and names, and how its video is encoded."""

from typing import Any

import numpy as np
from numpy import ndarray

from nerf_rl.datasets.export.lerobot.episodes import Episode
from nerf_rl.datasets.export.lerobot.plan import ExportedCamera, Plan
from nerf_rl.datasets.export.lerobot.videos import DEPTH, Codec, colours

STATE, PRIVILEGED, ACTION = "observation.state", "privileged_state", "action"
_GROUPS = {STATE: "proprio", PRIVILEGED: "privileged", ACTION: "action"}


def columns(plan: Plan, index: int, episode: Episode, first: int) -> dict[str, ndarray]:
    """Return the numbers of an episode's T frames by feature: [T] for single numbers, else [T, ...].

    A frame is a state and the step from it. What ``next`` names was recorded with the state that the step led to, and
    the last state, from which no step is known, has no frame.

    Args:
        plan: what is exported.
        index: of the episode in the export.
        episode: to read.
        first: how many frames there are before it.
    """
    states, T = episode.states, episode.transitions
    values = {key: plan.dataset.read(f"state/{group}", states)[:-1] for key, group in _GROUPS.items()}
    if any(camera.world_from_camera is None for camera in plan.cameras):
        poses = np.linalg.inv(plan.dataset.cameras(states)[1][:-1]).astype(np.float32)
        moving = [camera for camera in plan.cameras if camera.world_from_camera is None]
        values |= {camera.pose_key: poses[:, camera.view] for camera in moving}
    steps = np.arange(T)
    values |= {
        "next.reward": plan.dataset.read("reward", states)[1:],
        "next.success": plan.dataset.read("success", states)[1:].astype(bool),
        "next.done": steps == T - 1,
        "timestamp": (steps / plan.fps).astype(np.float32),
        "frame_index": steps,
        "episode_index": np.full(T, index),
        "index": first + steps,
        "task_index": np.zeros(T, np.int64),
    }
    single = {key: value[:, 0] if value.shape[1:] == (1,) else value for key, value in values.items()}
    return {key: value for key, value in single.items() if value.size}


def described(plan: Plan, example: dict[str, ndarray]) -> dict[str, dict[str, Any]]:
    """Return LeRobot's description of all features.

    Args:
        plan: what is exported.
        example: the columns of an episode.
    """
    found: dict[str, dict[str, Any]] = {}
    for camera in plan.cameras:
        found[camera.image_key] = _video(plan, colours(*_size(plan)), 3, {"is_depth_map": False})
        if camera.codes is not None:
            found[camera.depth_key] = _video(plan, DEPTH, 1, _depth_info(camera))
    for key, values in example.items():
        names = list(plan.dataset.columns(_GROUPS[key])) if key in _GROUPS else None
        shape = list(values.shape[1:]) or [1]
        found[key] = {"dtype": values.dtype.name, "shape": shape, "names": names}
    return found


def _video(plan: Plan, codec: Codec, channels: int, info: dict[str, Any]) -> dict[str, Any]:
    height, width = _size(plan)
    return {
        "dtype": "video",
        "shape": [height, width, channels],
        "names": ["height", "width", "channels"],
        "info": {
            "video.height": height,
            "video.width": width,
            "video.fps": plan.fps,
            "video.channels": channels,
            **codec.described(),
            "has_audio": False,
            **info,
        },
    }


def _depth_info(camera: ExportedCamera) -> dict[str, Any]:
    assert camera.codes is not None
    return {
        "video.depth_min": camera.codes.nearest,
        "video.depth_max": camera.codes.farthest,
        "video.shift": 0.0,
        "video.use_log": True,
        "is_depth_map": True,
        "depth_unit": "m",
    }


def _size(plan: Plan) -> tuple[int, int]:
    return plan.dataset.manifest["height"], plan.dataset.manifest["width"]
