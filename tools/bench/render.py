"""Compare our multi-view rendering with MuJoCo's own renderer, in speed and in what it shows.

Stock rendering takes three passes a view (colours, depth, segmentation) with the scene's shadows and multisampling.
Ours is measured with simplified meshes (`fast`), the same with four colours a pixel (`smooth`), and with full meshes
without shadows and multisampling (`plain`). All four render the same states from the same cameras in one process, in
one thread, and take turns; times are medians. How much a picture flickers is told by how far it is from the mean of 64
colours a pixel of full meshes.
Run from a checkout's root:

    .venv/bin/python -m tools.bench.render --json datasets/results/render.json
"""

import argparse
import os
import sys
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path

os.environ["LP_NUM_THREADS"] = "0"  # before OpenGL is loaded: no thread beside the one that draws

import nerf_rl  # isort: skip  # noqa: F401  chooses OpenGL's backend before MuJoCo is imported

import mujoco
import numpy as np
import torch
from numpy import ndarray
from torchmetrics.functional.classification import multiclass_jaccard_index

from nerf_rl.cameras.geometry import camera_position
from nerf_rl.cameras.rig_config import RigConfig
from nerf_rl.files.json_files import write_json
from nerf_rl.files.versions import git_revision, package_versions
from nerf_rl.metrics import psnr_db
from nerf_rl.rendering.renderer import MultiViewRenderer, Views
from nerf_rl.rendering.rigs import make_rig
from nerf_rl.rendering.semantics import semantic_classes
from nerf_rl.scenes.base import Scene
from nerf_rl.scenes.make import make_scene

REPEATS = {"stock": 2, "fast": 4, "smooth": 4, "plain": 4}  # in a turn
OURS = tuple(name for name in REPEATS if name != "stock")
FINER = 8  # colours a pixel, along each side, whose mean is what a picture should show


def main() -> None:
    """Measure, print and write."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--json", type=Path, help="result file to write")
    parser.add_argument("--scene", default="metaworld/drawer-open-v3")
    parser.add_argument("--size", type=int, default=128, help="image height and width [pixels]")
    parser.add_argument("--rounds", type=int, default=30, help="states to render, each by every way in turn")
    parser.add_argument("--seed", type=int, default=0, help="of the states")
    arguments = parser.parse_args()
    result = measure(make_scene(arguments.scene), arguments.size, arguments.rounds, arguments.seed)
    result = {
        **result,
        "scene": arguments.scene,
        "size": arguments.size,
        "rounds": arguments.rounds,
        "seed": arguments.seed,
        "command": " ".join(["python -m tools.bench.render", *sys.argv[1:]]),
        "git_revision": git_revision(),
        "packages": package_versions(),
        "cpus": os.cpu_count(),
    }
    for name in ("ratio", "ratio_full_mesh", "mask_iou", "rgb_psnr_db", "psnr_db_of_means", "milliseconds_per_view"):
        print(name, result[name])
    if arguments.json:
        arguments.json.parent.mkdir(parents=True, exist_ok=True)
        write_json(arguments.json, result)


def measure(scene: Scene, size: int, rounds: int, seed: int) -> dict:
    """Render states along random episodes in all ways; return medians of times and what the fast way shows."""
    rig = make_rig(RigConfig(), size, scene)
    model, data = scene.model, scene.data
    scene.env.reset(seed=seed)
    intrinsics, poses = rig.intrinsics, rig.poses(data, np.random.default_rng(seed))
    sizes, sharpness = (size, size, len(poses)), rig.pixels_per_metre(data)
    ours = {quality: MultiViewRenderer(model, *sizes, quality, sharpness) for quality in OURS}
    finer = MultiViewRenderer(model, FINER * size, FINER * size, len(poses), "plain", FINER * sharpness)
    closer = np.concatenate([FINER * intrinsics[:, :2], intrinsics[:, 2:]], axis=1)
    stock = StockRenderer(model, size, poses)
    ways: dict[str, Callable[[], object]] = {
        "stock": lambda: stock.render(data),
        **{name: partial(renderer.render, data, intrinsics, poses) for name, renderer in ours.items()},
    }
    classes = semantic_classes(model, scene.parts)
    labels: dict[str, list[ndarray]] = {"fast": [], "plain": []}
    times: dict[str, list[float]] = {name: [] for name in ways}
    errors: list[float] = []
    flicker: dict[str, list[float]] = {name: [] for name in OURS}
    rng = np.random.default_rng(seed)
    for turn in range(rounds + 1):
        act(scene, rng)
        seen: dict[str, Views] = {}
        for name in rng.permutation(list(ways)).tolist():
            for _ in range(REPEATS[name]):
                start = time.perf_counter()
                seen[name] = ways[name]()  # type: ignore[assignment]
                times[name].append((time.perf_counter() - start) / len(poses))
        if turn == 0:
            times = {name: [] for name in ways}  # the first rendering compiles shaders
        for name, found in labels.items():
            found.append(classes.label(seen[name].geom))
        errors.append(mean_squared_error(seen["fast"].rgb, seen["plain"].rgb))
        means = block_means(finer.render_rgb(data, closer, poses))
        for name, found in flicker.items():
            found.append(mean_squared_error(seen[name].rgb, means))
    gl_renderer = finer.gl_renderer
    for renderer in (*ours.values(), finer, stock):
        renderer.close()
    milliseconds = {name: round(1e3 * float(np.median(values)), 3) for name, values in times.items()}
    simplified, full = (torch.from_numpy(np.stack(labels[name])).long() for name in ("fast", "plain"))
    iou = multiclass_jaccard_index(simplified, full, len(classes.names), average="none")
    return {
        "ratio": round(milliseconds["stock"] / milliseconds["fast"], 2),
        "ratio_full_mesh": round(milliseconds["stock"] / milliseconds["plain"], 2),
        "ratio_smooth": round(milliseconds["stock"] / milliseconds["smooth"], 2),
        "mask_iou": round(float(multiclass_jaccard_index(simplified, full, len(classes.names))), 4),
        "rgb_psnr_db": round(psnr_db(float(np.mean(errors))), 2),
        "psnr_db_of_means": {name: round(psnr_db(float(np.mean(found))), 2) for name, found in flicker.items()},
        "milliseconds_per_view": milliseconds,
        "class_iou": {name: round(float(value), 4) for name, value in zip(classes.names, iou, strict=True)},
        "views": len(poses),
        "renderer": gl_renderer,
        "raw_milliseconds_per_view": {name: [round(1e3 * t, 3) for t in values] for name, values in times.items()},
    }


def act(scene: Scene, rng: np.random.Generator) -> None:
    """Reset the scene and take some of the scripted policy's steps, with noise."""
    observation, _ = scene.env.reset(seed=int(rng.integers(2**31)))
    policy = scene.scripted_policy()
    space = scene.env.action_space
    for _ in range(int(rng.integers(0, 80))):
        action = rng.uniform(space.low, space.high) if policy is None else policy(observation)  # type: ignore[attr-defined]
        noisy = np.clip(action + 0.3 * rng.standard_normal(space.shape), space.low, space.high)  # type: ignore[attr-defined]
        observation, *_ = scene.env.step(noisy.astype(np.float32))


def block_means(pictures: ndarray) -> ndarray:
    """Return pictures [V, H, W, 3] in which each pixel is the mean of FINER x FINER."""
    views, height, width, _ = pictures.shape
    return pictures.reshape(views, height // FINER, FINER, width // FINER, FINER, 3).mean((2, 4))


def mean_squared_error(first: ndarray, second: ndarray) -> float:
    """Return the mean squared difference of colours in [0, 1]."""
    return float(np.mean(((first.astype(float) - second) / 255) ** 2))


class StockRenderer:
    """MuJoCo's own renderer, with its three passes a view."""

    def __init__(self, model: mujoco.MjModel, size: int, camera_from_world: ndarray):
        self._renderer = mujoco.Renderer(model, size, size)
        self._cameras = []
        for position, forward in zip(camera_position(camera_from_world), camera_from_world[:, 2, :3], strict=True):
            x, y, z = forward
            camera = mujoco.MjvCamera()
            camera.lookat[:], camera.distance = position + forward, 1.0
            camera.azimuth, camera.elevation = np.rad2deg([np.arctan2(y, x), np.arcsin(z)])
            self._cameras.append(camera)

    def render(self, data: mujoco.MjData) -> list[tuple[ndarray, ndarray, ndarray]]:
        """Return colours, depth and segmentation of each camera."""
        views = []
        for camera in self._cameras:
            self._renderer.update_scene(data, camera)
            colours = self._renderer.render()
            self._renderer.enable_depth_rendering()
            depth = self._renderer.render()
            self._renderer.disable_depth_rendering()
            self._renderer.enable_segmentation_rendering()
            segmentation = self._renderer.render()
            self._renderer.disable_segmentation_rendering()
            views.append((colours, depth, segmentation))
        return views

    def close(self) -> None:
        """Free the OpenGL resources."""
        self._renderer.close()


if __name__ == "__main__":
    main()
