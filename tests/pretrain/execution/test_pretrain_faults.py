"""Steps that fail: what they say and what stays; runs that are good enough before their end."""

import json
from pathlib import Path
from typing import Any

import pytest
import torch

from nerf_rl import cli
from nerf_rl.datasets.storage.reader import MultiViewDataset
from nerf_rl.errors import UserError
from nerf_rl.pretrain.config import PretrainConfig
from nerf_rl.pretrain.data.batches import RayBatches, drawn_frames
from nerf_rl.pretrain.data.statistics import measure
from nerf_rl.pretrain.execution.faults import is_out_of_memory
from nerf_rl.pretrain.objectives.snerl_module import SnerlModule
from nerf_rl.pretrain.stopping import Goal, parse_goal


def pretrain(recipe: Path, data: Path, out: Path, *arguments: str) -> int:
    return cli.main(["pretrain", "--config", str(recipe), "--data", str(data), "--out", str(out), *arguments])


@pytest.mark.parametrize("threads", ["1", "2"])
def test_a_gradient_that_is_not_finite_ends_the_run_before_it_is_taken(
    tiny_dataset: Path,
    tiny_pretraining_recipe: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    threads: str,
):
    read = RayBatches.__getitem__

    def spoilt(self: RayBatches, step: int) -> Any:
        batch = read(self, step)
        return batch._replace(depth=batch.depth * float("nan")) if step == 3 else batch

    with monkeypatch.context() as patch:
        patch.setattr(RayBatches, "__getitem__", spoilt)
        assert pretrain(tiny_pretraining_recipe, tiny_dataset, tmp_path / "run", "--threads", threads) == 1
    told = capsys.readouterr().err
    assert "the gradient of step 3 is not finite" in told and "depth nan" in told and "Traceback" not in told
    failed = json.loads((tmp_path / "run/failed_batch.json").read_text())
    assert failed["step"] == 3 and failed["seed"] == 5
    dataset, config = MultiViewDataset(tiny_dataset), PretrainConfig("d", "o", scenes_per_step=2, seed=5)
    batch = RayBatches(dataset, config, measure(dataset, config))[3]
    for frame, images in zip(failed["frames"], batch.images.numpy(), strict=True):
        assert (dataset.read("rgb", [frame])[0, dataset.views("encoder")] == images).all()
    assert drawn_frames(dataset, config, 3).tolist() == failed["frames"]
    checkpoint = torch.load(tmp_path / "run/checkpoints/last.ckpt", weights_only=True)
    assert checkpoint["global_step"] == 2
    assert all(bool(value.isfinite().all()) for value in checkpoint["state_dict"].values())
    assert pretrain(tiny_pretraining_recipe, tiny_dataset, tmp_path / "run", "--resume", "true") == 0  # mended data


@pytest.mark.parametrize(
    "objective, what", [("field", "the field's colours"), ("autoencoder", "the encoder's latents")]
)
def test_weights_that_compute_no_numbers_end_the_run_before_they_are_kept(
    objective: str,
    what: str,
    tiny_dataset: Path,
    tiny_pretraining_recipe: Path,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
):
    words = ["--objective", objective, "--learning_rate", "1e30", "--steps_per_epoch", "1"]
    if objective == "field":
        words += ["--epochs_per_validation", "1"]
    assert pretrain(tiny_pretraining_recipe, tiny_dataset, tmp_path / "run", *words) == 1
    said = capsys.readouterr().err.splitlines()[-1]
    assert f"the run diverged: after step 1 {what} are not finite" in said and "lower --learning_rate" in said
    assert not list((tmp_path / "run").rglob("last.ckpt")) and not (tmp_path / "run/summary.json").exists()


@pytest.mark.parametrize(
    "error",
    [
        torch.OutOfMemoryError("CUDA out of memory. Tried to allocate 20.00 GiB."),
        RuntimeError("[enforce fail at alloc_cpu.cpp:124] err == 0. DefaultCPUAllocator: can't allocate memory"),
        MemoryError(),
    ],
)
@pytest.mark.parametrize("where", ["__init__", "_losses"])
def test_too_little_memory_names_the_keys(
    error: Exception,
    where: str,
    tiny_dataset: Path,
    tiny_pretraining_recipe: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
):
    def fails(self: SnerlModule, *_: Any) -> Any:
        raise error

    monkeypatch.setattr(SnerlModule, where, fails)
    assert pretrain(tiny_pretraining_recipe, tiny_dataset, tmp_path / "run") == 1
    told = capsys.readouterr().err
    assert "out of memory on cpu: lower --scenes_per_step, --rays_per_scene" in told and "Traceback" not in told


def test_memory_that_cannot_be_had_is_recognised():
    with pytest.raises(RuntimeError) as refusal:
        torch.empty(2**60, dtype=torch.uint8)
    assert is_out_of_memory(refusal.value)
    assert not is_out_of_memory(RuntimeError("shapes cannot be multiplied"))
    assert not is_out_of_memory(ValueError("out of memory"))


@pytest.mark.parametrize(
    "text, goal",
    [
        ("miou>=0.9", Goal("miou", True, 0.9)),
        (" depth_mae_m <= 2e-2 ", Goal("depth_mae_m", False, 0.02)),
        ("psnr_db>=24", Goal("psnr_db", True, 24.0)),
    ],
)
def test_goals_are_read(text: str, goal: Goal):
    assert parse_goal(text) == goal
    figures = {goal.measure: goal.value}
    beyond = goal.value + (-0.001 if goal.at_least else 0.001)
    assert goal.is_reached(figures)
    assert not goal.is_reached({goal.measure: beyond}) and not goal.is_reached({goal.measure: None})


@pytest.mark.parametrize(
    "text, fault",
    [
        ("miou>0.9", "takes MEASURE>=NUMBER"),
        ("miou>=high", "takes"),
        ("iou>=0.9", "did you mean miou"),
        ("miou", "in quotes, since a shell takes"),  # what a shell leaves of miou>=0.9
    ],
)
def test_what_is_no_goal_is_told(text: str, fault: str):
    with pytest.raises(UserError, match=fault):
        PretrainConfig("data", "out", stop_when=text)


def test_a_goal_needs_validations():
    with pytest.raises(UserError, match="--stop_when needs validations"):
        PretrainConfig("data", "out", stop_when="miou>=0.9", objective="autoencoder")


@pytest.mark.parametrize("goal, steps", [("psnr_db>=1", 4), ("psnr_db>=90", 6)])
def test_a_run_stops_where_it_is_good_enough(
    goal: str, steps: int, tiny_dataset: Path, tiny_pretraining_recipe: Path, tmp_path: Path
):
    """Validations are after four steps and at the end."""
    assert pretrain(tiny_pretraining_recipe, tiny_dataset, tmp_path / "run", "--stop_when", goal) == 0
    summary = json.loads((tmp_path / "run/summary.json").read_text())
    assert summary["steps"] == steps and summary["validation"]["psnr_db"] > 1
    assert (tmp_path / "run/encoder.safetensors").exists()


def test_a_run_that_was_good_enough_stays_at_its_end_when_it_is_resumed(
    tiny_dataset: Path, tiny_pretraining_recipe: Path, tmp_path: Path
):
    """As one is that was killed while its encoder was probed; another goal, which it has not reached, lets it go on."""
    words = tiny_pretraining_recipe, tiny_dataset, tmp_path / "run", "--stop_when"
    for goal, steps in (("psnr_db>=1", 4), ("psnr_db>=1", 4), ("psnr_db>=90", 6)):
        assert pretrain(*words, goal, "--resume", "true") == 0
        summary = json.loads((tmp_path / "run/summary.json").read_text())
        assert summary["steps"] == steps and summary["class_iou"]


def test_a_run_without_time_for_a_step_is_measured_on_all_held_out_frames(
    tiny_dataset: Path, tiny_pretraining_recipe: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    seen = []
    validate = SnerlModule.validation_step

    def count(self: SnerlModule, frame: int, step: int) -> None:
        seen.append(int(frame))
        validate(self, frame, step)

    monkeypatch.setattr(SnerlModule, "validation_step", count)
    assert pretrain(tiny_pretraining_recipe, tiny_dataset, tmp_path / "run", "--max_minutes", "1e-6") == 0
    assert json.loads((tmp_path / "run/summary.json").read_text())["steps"] == 0
    assert len(set(seen)) == 2  # Lightning's check before training looks at the first alone
