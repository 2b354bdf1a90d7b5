"""What several test files share: the scene, a tiny dataset and a tiny encoder, made once a session by the commands."""

import os
import signal
from collections.abc import Iterator
from pathlib import Path

os.environ.setdefault("OMP_NUM_THREADS", "1")  # there is a test on each core: their threads would wait for each other
os.environ.setdefault("OMP_WAIT_POLICY", "passive")  # where a test asks for threads, they wait without using the cores

import annotations  # before anything of the package, whose annotations it makes cheaper to check
import lightning  # noqa: F401  before anything renders: Triton, which it loads, crashes after software OpenGL's LLVM
import pytest
import torch
from tiny_recipes import TINY_DATASET, TINY_PRETRAINING, TINY_TRAINING, travelling_recipe

from nerf_rl import cli  # before any test file imports mujoco, which reads the OpenGL backend's name once
from nerf_rl.machine.processes import start_server
from nerf_rl.scenes.base import Scene
from nerf_rl.scenes.make import make_scene

import warm_start  # isort: skip  # noqa: F401

if signal.getsignal(signal.SIGINT) == signal.SIG_IGN:  # started in the background: what tests start would ignore Ctrl-C
    signal.signal(signal.SIGINT, signal.default_int_handler)


if not torch.cuda.is_available():  # Lightning has every step of an optimiser ask for that, by opening a library
    os.environ["PYTORCH_NVML_BASED_CUDA_CHECK"] = "0"


@pytest.fixture(autouse=True)
def one_thread() -> Iterator[None]:
    """Take back the threads that a command has asked PyTorch for."""
    yield
    torch.set_num_threads(int(os.environ["OMP_NUM_THREADS"]))


@pytest.fixture(autouse=True)
def checked_anew() -> None:
    """Have annotations checked in each test's first calls."""
    annotations.check_anew()


@pytest.fixture(scope="session", autouse=True)
def server_of_workers() -> None:
    """Let all worker processes be forks of one that has imported what any of them needs, whoever asks first.

    After one that needs little, each later one would import PyTorch, which takes seconds.
    """
    names = ("rl.environments.make", "rl.environments.observation", "rl.environments.controls", "rl.training.loop")
    names += (
        "datasets.generation.workers",
        "scenes.metaworld",
        "tuning.objective",
        "tuning.worker",
        "pretrain.fitting",
    )
    with pytest.MonkeyPatch.context() as environment:
        environment.setenv("PYTHONPATH", str(Path(__file__).parent), prepend=os.pathsep)  # which has warm_start
        start_server([*(f"nerf_rl.{name}" for name in names), "warm_start"])


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


@pytest.fixture(scope="session")
def travelling_dataset(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A tiny dataset of a robot that travels; tests leave it as it is."""
    folder = tmp_path_factory.mktemp("travelling")
    (folder / "data.yaml").write_text(travelling_recipe())
    assert cli.main(["gen-dataset", "--config", str(folder / "data.yaml"), "--out", str(folder / "dataset")]) == 0
    return folder / "dataset"


@pytest.fixture(scope="session")
def travelling_encoder(
    travelling_dataset: Path, tiny_pretraining_recipe: Path, tmp_path_factory: pytest.TempPathFactory
) -> Path:
    """The run folder of an encoder with cameras that follow a robot; tests leave it as it is."""
    folder = tmp_path_factory.mktemp("travelling") / "encoder"
    arguments = ["--config", str(tiny_pretraining_recipe), "--data", str(travelling_dataset), "--out", str(folder)]
    assert cli.main(["pretrain", *arguments]) == 0
    return folder
