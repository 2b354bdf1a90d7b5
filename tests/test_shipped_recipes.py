"""The shipped recipes, run by the commands that read them: only frames, steps and pixels are fewer.

Whatever a machine decides by itself (OpenGL's backend, threads, precision, extras) is forced both ways, here, in
test_precision.py, test_pretrain_devices.py and test_extras.py.
"""

import ctypes
import json
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
from tiny_recipes import STEPS_OF_RECIPE

from nerf_rl import cli
from nerf_rl.datasets.storage.reader import MultiViewDataset

ROOT = Path(__file__).parents[1]
FEW_FRAMES = ["--episodes", "3", "--frames_per_episode", "2", "--size", "32"]
FEW_STEPS = ["--evaluation_episodes", "2", "--final_evaluation_episodes", "2"]
LIBRARIES = {"egl": "libEGL.so.1", "osmesa": "libOSMesa.so.8"}


def summary(folder: Path) -> dict[str, Any]:
    return json.loads((folder / "summary.json").read_text())


def stems(folder: str) -> list[str]:
    return sorted(path.stem for path in (ROOT / folder).glob("*.yaml"))


@pytest.mark.parametrize("recipe", stems("datasets"))
def test_a_dataset_recipe_generates(recipe: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.chdir(ROOT)  # one of them names its scene from there
    words = ["--config", f"datasets/{recipe}.yaml", "--out", str(tmp_path / "data"), *FEW_FRAMES]
    assert cli.main(["gen-dataset", *words]) == 0
    assert len(MultiViewDataset(tmp_path / "data")) == 6


def test_every_training_recipe_is_run():
    assert {*STEPS_OF_RECIPE, "tune"} == set(stems("rl"))


@pytest.mark.parametrize("recipe", STEPS_OF_RECIPE)
def test_a_training_recipe_trains(recipe: str, tiny_encoder: Path, tmp_path: Path):
    if recipe.startswith("panda"):
        pytest.importorskip("panda_gym", exc_type=ImportError)
    if recipe == "gym-goal":
        pytest.importorskip("gymnasium_robotics")
    if recipe.endswith(("ppo", "sb3", "sb3-ddpg")):
        pytest.importorskip("stable_baselines3")
    encoder = ["--encoder", str(tiny_encoder)] if recipe in ("demo", "drawer-open") else []
    words = ["--config", str(ROOT / "rl" / f"{recipe}.yaml"), "--out", str(tmp_path / "run"), *encoder]
    assert cli.main(["train-rl", *words, *STEPS_OF_RECIPE[recipe], *FEW_STEPS]) == 0
    result = summary(tmp_path / "run")
    assert result["updates"] > 0 and result["evaluations"][-1]["episodes"] == 2


@pytest.mark.parametrize("backend", LIBRARIES)
def test_either_backend_of_opengl_renders_the_dataset(backend: str, tmp_path: Path):
    try:
        ctypes.CDLL(LIBRARIES[backend])
    except OSError:
        pytest.skip(f"{LIBRARIES[backend]} is not installed")
    words = ["--config", "datasets/demo.yaml", "--out", str(tmp_path / "data"), *FEW_FRAMES]
    done = subprocess.run(
        [sys.executable, "-m", "nerf_rl.cli", "gen-dataset", *words],
        cwd=ROOT,
        env={**os.environ, "MUJOCO_GL": backend},
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, done.stderr
    data = MultiViewDataset(tmp_path / "data")
    assert data.read("rgb").std() > 20 and len(set(data.read("semantic").ravel().tolist())) > 3


@pytest.mark.parametrize("threads", [1, 2])
def test_either_number_of_threads_trains(threads: int, tiny_dataset: Path, tmp_path: Path):
    few = ["--steps", "3", "--validation_frames", "1", "--probe_frames", "9", "--threads", str(threads)]
    words = ["--config", str(ROOT / "pretrain" / "demo.yaml"), "--data", str(tiny_dataset), *few]
    assert cli.main(["pretrain", *words, "--out", str(tmp_path / "run")]) == 0
    assert summary(tmp_path / "run")["steps"] == 3
