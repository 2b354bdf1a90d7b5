"""What several test files share: the scene, a tiny dataset and a tiny encoder, made once a session by the commands."""

from pathlib import Path

import lightning  # noqa: F401  before anything renders: Triton, which it loads, crashes after software OpenGL's LLVM
import pytest

from nerf_rl import cli  # before any test file imports mujoco, which reads the OpenGL backend's name once
from nerf_rl.datasets.scenes import Scene, make_scene

TINY_DATASET = """
scene: metaworld/drawer-open-v3
episodes: 4
frames_per_episode: 3
episode_steps: 12
size: 24
rig:
  cameras:
    - {name: top, azimuth: 90, elevation: -70}
    - {name: left, azimuth: 20, elevation: -30}
    - {name: right, azimuth: 160, elevation: -30}
  encoder: [left, right]
  test: [top]
  random: {count: 1}
validation_fraction: 0.25
episodes_per_shard: 2
workers: 1
seed: 3
"""

TINY_PRETRAINING = """
encoder: {latent: 8, patch: 4, channels: [8, 16], hidden: 16}
radiance_field: {width: 16, layers: 2, frequencies: 4, plane_size: 8, plane_features: 2}
sampling: {rendering_stratified: 6, rendering_importance: 4}
scenes_per_step: 2
rays_per_scene: 8
steps: 6
steps_per_epoch: 2
epochs_per_validation: 2
validation_frames: 2
probe_frames: 9
precision: "32"
threads: 1
seed: 5
"""

TINY_TRAINING = ["--env_steps", "80", "--warmup_steps", "40", "--episode_steps", "20", "--learner.batch_size", "8"]
TINY_TRAINING += ["--evaluation_every", "40", "--evaluation_episodes", "2", "--final_evaluation_episodes", "2"]
TINY_TRAINING += ["--replay.capacity", "200", "--network.hidden", "[16, 16]"]


@pytest.fixture(scope="session")
def drawer_open() -> Scene:
    """The drawer-open scene; a test that acts in it resets it first."""
    return make_scene("metaworld/drawer-open-v3")


@pytest.fixture(scope="session")
def tiny_recipe(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The recipe of the tiny dataset: 2 shards x 2 episodes x 3 frames, 4 cameras, 24 pixels."""
    path = tmp_path_factory.mktemp("recipe") / "tiny.yaml"
    path.write_text(TINY_DATASET)
    return path


@pytest.fixture(scope="session")
def tiny_dataset(tiny_recipe: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A tiny dataset, made with one worker; tests leave it as it is."""
    folder = tmp_path_factory.mktemp("tiny") / "dataset"
    assert cli.main(["gen-dataset", "--config", str(tiny_recipe), "--out", str(folder)]) == 0
    return folder


@pytest.fixture(scope="session")
def tiny_pretraining_recipe(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The recipe of the tiny encoder: 6 steps in 3 epochs."""
    path = tmp_path_factory.mktemp("recipe") / "pretrain.yaml"
    path.write_text(TINY_PRETRAINING)
    return path


@pytest.fixture(scope="session")
def tiny_encoder(tiny_dataset: Path, tiny_pretraining_recipe: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The run folder of an encoder that was trained for a few steps; tests leave it as it is."""
    folder = tmp_path_factory.mktemp("tiny") / "encoder"
    arguments = ["--config", str(tiny_pretraining_recipe), "--data", str(tiny_dataset), "--out", str(folder)]
    assert cli.main(["pretrain", *arguments]) == 0
    return folder


@pytest.fixture(scope="session")
def tiny_agent(tiny_encoder: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The run folder of an agent that was trained for a few steps on the tiny encoder; tests leave it as it is."""
    folder = tmp_path_factory.mktemp("tiny") / "agent"
    assert cli.main(["train-rl", "--encoder", str(tiny_encoder), "--out", str(folder), *TINY_TRAINING]) == 0
    return folder
