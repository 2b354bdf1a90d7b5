"""Scenes as programs of others write them, their import, and a few steps of training on it."""

import json
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from nerf_rl import cli
from nerf_rl.cameras.geometry import look_from
from nerf_rl.datasets.export.nerfstudio import world_from_opengl_camera
from nerf_rl.datasets.storage.reader import MultiViewDataset

HEIGHT, WIDTH, NAMES = 20, 28, ("a", "b", "c")
TINY = ["--steps", "4", "--steps_per_epoch", "2", "--epochs_per_validation", "2", "--validation_frames", "1"]
TINY += ["--scenes_per_step", "2", "--rays_per_scene", "8", "--threads", "1", "--probe_frames", "9"]
TINY += ["--sampling.rendering_stratified", "6", "--sampling.rendering_importance", "4"]


def read(source: Path, out: Path, *keys: str) -> MultiViewDataset:
    """Import, and return the dataset."""
    assert cli.main(["import", str(source), "--out", str(out), *keys]) == 0
    return MultiViewDataset(out)


def write_capture(folder: Path, moments: int = 4, seed: int = 0, **shared: Any) -> None:
    """Write scenes as programs of others do: JPEG pictures, shared intrinsics, no depth, labels or words of ours."""
    rng = np.random.default_rng(seed)
    eyes = np.array([[1.0, 0.0, 0.6], [0.0, 1.2, 0.5], [-0.9, 0.3, 0.8]])
    for moment in range(moments):
        scene = folder / f"moment_{moment}"
        (scene / "images").mkdir(parents=True)
        frames = []
        for name, eye in zip(NAMES, eyes, strict=True):
            picture = cv2.resize(rng.integers(0, 255, (4, 6, 3), np.uint8), (WIDTH, HEIGHT))
            cv2.imwrite(str(scene / "images" / f"{name}.jpg"), picture)
            pose = world_from_opengl_camera(look_from(eye, np.zeros(3)))
            frames.append({"file_path": f"./images/{name}.jpg", "transform_matrix": pose.tolist()})
        camera = {"fl_x": 24.0, "fl_y": 25.0, "cx": 14.5, "cy": 9.5, "w": WIDTH, "h": float(HEIGHT)}
        content = {"camera_model": "OPENCV", **camera, **shared, "frames": frames}
        (scene / "transforms.json").write_text(json.dumps(content))
