"""Compare the first episode of a fresh process with the same episode after others, for every Meta-World task.

Run from a checkout's root; it writes datasets/results/seeds.json (minutes):

    .venv/bin/python -m tools.bench.seeds
    .venv/bin/python -m tools.bench.seeds metaworld/soccer-v3    # prints this alone, writes nothing
"""

import argparse
import hashlib
import multiprocessing
import sys
import time
from collections import defaultdict
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np

from nerf_rl.cameras.rig_config import RigConfig
from nerf_rl.files.json_files import write_json
from nerf_rl.files.versions import git_revision, package_versions
from nerf_rl.machine.gl import use_one_software_thread
from nerf_rl.rendering.renderer import MultiViewRenderer
from nerf_rl.rendering.rigs import make_rig
from nerf_rl.scenes.base import Scene
from nerf_rl.scenes.make import make_scene
from tools.bench.scenes import metaworld_tasks

SIZES = {"seeds": [7, 1_234_567], "steps": 30, "size": 64, "steps_of_others": [60, 0, 13]}


def main() -> None:
    """Run all tasks, or those named; exit with 1 if an episode depends on what came before."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scenes", nargs="*", metavar="SCENE")
    parser.add_argument("--workers", type=int, default=2)
    options = parser.parse_args()
    start, revision, results = time.monotonic(), git_revision(), {}
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(options.workers, context, max_tasks_per_child=1) as fresh_processes:
        names = options.scenes or metaworld_tasks()
        jobs = {
            name: [
                (fresh_processes.submit(digests, name, seed, []), fresh_processes.submit(digests, name, seed, others))
                for seed, others in ((seed, SIZES["steps_of_others"]) for seed in SIZES["seeds"])
            ]
            for name in names
        }
        for name, pairs in jobs.items():
            differing = {
                kind
                for first, later in pairs
                for kind, digest in first.result().items()
                if digest != later.result()[kind]
            }
            results[name] = sorted(differing)
            print(name, "differs in " + ", ".join(results[name]) if differing else "is the same", flush=True)
    failed = [name for name, differing in results.items() if differing]
    if not options.scenes:
        write_json(
            Path("datasets/results/seeds.json"),
            {
                "command": " ".join(["python -m tools.bench.seeds", *sys.argv[1:]]),
                "git_revision": revision,
                "packages": package_versions(),
                "sizes": SIZES,
                "seconds": round(time.monotonic() - start, 1),
                "tasks": len(results),
                "failed": failed,
                "differing": results,
            },
        )
    sys.exit(1 if failed else 0)


def digests(name: str, seed: int, others: list[int]) -> dict[str, str]:
    """Return the SHA-256 of all that an episode holds, by kind.

    Args:
        name: of a scene.
        seed: of the episode.
        others: how many steps are made of each of the episodes before, which have other seeds.
    """
    use_one_software_thread()
    scene = make_scene(name)
    for number, steps in enumerate(others):
        act(scene, 100 + number, steps)
    found: dict[str, Any] = defaultdict(hashlib.sha256)
    for kind, array in act(scene, seed, SIZES["steps"]):
        found[kind].update(np.ascontiguousarray(array).tobytes())
    return {kind: digest.hexdigest() for kind, digest in found.items()}


def act(scene: Scene, seed: int, steps: int) -> list[tuple[str, np.ndarray]]:
    """Run an episode of fixed actions; return its arrays, with frames of the first state and the last."""
    rng, arrays = np.random.default_rng(0), []
    observation, _ = scene.env.reset(seed=seed)
    arrays += [("reset observation", observation), *model_places(scene), *frames(scene)]
    for _ in range(steps):
        action = rng.uniform(-1, 1, scene.env.action_space.shape).astype(np.float32)
        observation, reward, *_ = scene.env.step(action)
        arrays += [("observation", observation), ("reward", np.array(reward)), ("qpos", scene.data.qpos.copy())]
        arrays += [("qvel", scene.data.qvel.copy()), ("privileged", scene.privileged(observation))]
    return [*arrays, *model_places(scene), *frames(scene)]


def model_places(scene: Scene) -> list[tuple[str, np.ndarray]]:
    """Return where the model has its bodies and sites."""
    return [(name, getattr(scene.model, name).copy()) for name in ("body_pos", "body_quat", "site_pos", "site_quat")]


def frames(scene: Scene) -> list[tuple[str, np.ndarray]]:
    """Return what the scene's own cameras see."""
    size = SIZES["size"]
    rig = make_rig(RigConfig(), size, scene)
    renderer = MultiViewRenderer(scene.model, size, size, len(rig.names))
    poses = rig.poses(scene.render_data(), np.random.default_rng(0))
    views = renderer.render(scene.render_data(), rig.intrinsics, poses)
    renderer.close()
    return list(views._asdict().items())


if __name__ == "__main__":
    main()
