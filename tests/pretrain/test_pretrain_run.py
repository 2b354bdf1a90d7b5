"""A tiny pretraining run of the real command: what it writes, how it resumes, how it refuses."""

import csv
import json
import shutil
import signal
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
import torch

from nerf_rl import cli
from nerf_rl.datasets.storage.reader import MultiViewDataset
from nerf_rl.metrics import psnr_db
from nerf_rl.pretrain.config import SamplingConfig
from nerf_rl.pretrain.data import learnable, statistics
from nerf_rl.pretrain.data.anchors import Anchors
from nerf_rl.pretrain.model.encoder import DESCRIPTION, WEIGHTS, Encoder
from nerf_rl.pretrain.model.encoder_rig import EncoderRig
from nerf_rl.pretrain.model.field import RadianceField
from nerf_rl.pretrain.model.ray_rendering import render_images
from nerf_rl.pretrain.objectives.snerl_module import SnerlModule

STEPS = 6


def pretrain(recipe: Path, data: Path, out: Path, *arguments: str) -> int:
    return cli.main(["pretrain", "--config", str(recipe), "--data", str(data), "--out", str(out), *arguments])


def logged(run: Path, column: str) -> list[float]:
    """Return the values of a column of a run's CSV log."""
    with open(run / "logs" / "metrics.csv") as file:
        return [float(row[column]) for row in csv.DictReader(file) if row.get(column)]


@pytest.fixture
def interruptible() -> Iterator[None]:
    """Restore the handler of interruptions, which Lightning switches off."""
    handler = signal.getsignal(signal.SIGINT)
    yield
    signal.signal(signal.SIGINT, handler)


def test_the_summary_has_its_figures(tiny_encoder: Path):
    summary = json.loads((tiny_encoder / "summary.json").read_text())
    assert {"steps", "seconds", "peak_rss_mb", "validation", "probe"} <= set(summary)
    assert summary["steps"] == STEPS and summary["seconds"] > 0 and summary["peak_rss_mb"] > 50
    assert list(summary["validation"]) == ["psnr_db", "ssim", "miou", "depth_mae_m"]
    assert 0 <= summary["validation"]["miou"] <= 1 and 0 < summary["validation"]["psnr_db"] < 60
    for probe, name, unit in (("probe", "hand_x", "mm"), ("joint_probe", "right_j0", "deg")):
        kinds = {f"rmse_{unit}", f"median_{unit}", "r2"}
        assert set(summary[probe][name]) == kinds | {f"network_{kind}" for kind in kinds}


def test_cameras_that_the_encoder_does_not_see_have_figures_of_their_own(tiny_encoder: Path, tiny_dataset: Path):
    summary = json.loads((tiny_encoder / "summary.json").read_text())
    others = summary["validation_other_cameras"]
    assert set(others) == {"test", "supervision"}
    dataset, encoder, field = (
        MultiViewDataset(tiny_dataset),
        Encoder.load(tiny_encoder),
        RadianceField.load(tiny_encoder),
    )
    sampling = SamplingConfig(rendering_stratified=6, rendering_importance=4)
    held_out = dataset.split("validation")
    frames = held_out[[0, len(held_out) - 1]]  # as many as the recipe asks for
    for role in others:
        decibels = []
        for frame in frames.tolist():
            (view,) = dataset.views(role)
            images = dataset.read("rgb", [frame])
            latent = encoder.encode(torch.from_numpy(images[:, dataset.views("encoder")]))[0]
            intrinsics, poses = dataset.cameras([frame])
            seen = render_images(field, latent, intrinsics[[view]], poses[0, [view]], 24, 24, sampling)
            decibels.append(psnr_db(float(((seen.rgb[0] - images[0, view] / 255.0) ** 2).mean())))
        assert others[role]["psnr_db"] == pytest.approx(np.mean(decibels), abs=1e-3)
        assert logged(tiny_encoder, f"validation_{role}/psnr_db")[-1] == pytest.approx(others[role]["psnr_db"])
    assert list(others["test"]) == list(summary["validation"])


def test_the_artefact_describes_where_the_encoder_came_from(tiny_encoder: Path, tiny_dataset: Path):
    description = json.loads((tiny_encoder / DESCRIPTION).read_text())
    dataset = MultiViewDataset(tiny_dataset)
    summary = json.loads((tiny_encoder / "summary.json").read_text())
    assert description["classes"] == list(dataset.class_names)
    assert description["dataset"]["sha256"] == dataset.digest()
    assert (description["probe"], description["joint_probe"]) == (summary["probe"], summary["joint_probe"])
    Encoder.load(tiny_encoder).rig.require_same(EncoderRig.of_dataset(dataset))
    field = RadianceField.load(tiny_encoder)
    assert field.sizes["classes"] == len(dataset.class_names) and field.sizes["latent"] == 8


def test_latents_are_standardised_over_the_training_frames(tiny_encoder: Path, tiny_dataset: Path):
    dataset, encoder = MultiViewDataset(tiny_dataset), Encoder.load(tiny_encoder)
    frames = dataset.split("train")
    images = torch.from_numpy(dataset.read("rgb", frames)[:, dataset.views("encoder")])
    matrices = torch.from_numpy(encoder.rig.projections).expand(len(frames), -1, -1, -1)
    standard = encoder.standardise(encoder(images, matrices)).numpy()
    np.testing.assert_allclose(standard.mean(0), 0.0, atol=1e-2)
    varying = encoder.latent_std.numpy() > 2e-4  # others are left small, not blown up
    np.testing.assert_allclose(standard.std(0)[varying], 1.0, atol=1e-2)


def test_every_loss_is_logged_by_name(tiny_encoder: Path):
    with open(tiny_encoder / "logs" / "metrics.csv") as file:
        columns = set(csv.DictReader(file).fieldnames or ())
    assert {f"validation/{name}" for name in ("psnr_db", "ssim", "miou", "depth_mae_m")} <= columns
    assert list((tiny_encoder / "logs").glob("events.out.tfevents*"))
    assert logged(tiny_encoder, "validation/psnr_db")


def test_reconstructions_are_pictures_of_all_encoder_cameras(tiny_encoder: Path):
    pictures = sorted((tiny_encoder / "reconstructions").glob("*.png"))
    assert pictures
    image = cv2.imread(str(pictures[-1]))
    assert image is not None and image.shape[1] >= 2 * 24 and image.std() > 5


def test_training_that_was_killed_resumes_to_the_same_bits(
    tiny_encoder: Path,
    tiny_dataset: Path,
    tiny_pretraining_recipe: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
):
    step = SnerlModule.training_step

    def killed(self: SnerlModule, *arguments: Any) -> Any:
        if self.global_step == 3:  # after the first checkpoint, before the second
            raise RuntimeError("killed")
        return step(self, *arguments)

    out = tmp_path / "run"
    with monkeypatch.context() as patch:
        patch.setattr(SnerlModule, "training_step", killed)
        assert pretrain(tiny_pretraining_recipe, tiny_dataset, out) == 1
    assert not (out / "summary.json").exists() and not (out / WEIGHTS).exists()
    torch.manual_seed(123)
    np.random.seed(123)
    assert pretrain(tiny_pretraining_recipe, tiny_dataset, out, "--resume", "true") == 0
    for name in (WEIGHTS, "field.safetensors"):
        assert (out / name).read_bytes() == (tiny_encoder / name).read_bytes(), name
    resumed, uninterrupted = (json.loads((run / "summary.json").read_text()) for run in (out, tiny_encoder))
    for key in ("steps", "validation", "validation_other_cameras", "probe", "joint_probe"):
        assert resumed[key] == uninterrupted[key]


def test_a_run_goes_on_with_its_own_dataset_alone_wherever_that_lies(
    tiny_encoder: Path,
    tiny_dataset: Path,
    tiny_recipe: Path,
    tiny_pretraining_recipe: Path,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
):
    other = ["gen-dataset", "--config", str(tiny_recipe), "--seed", "4", "--out", str(tmp_path / "other")]
    assert cli.main(other) == 0
    run = shutil.copytree(tiny_encoder, tmp_path / "run")
    before = {path: path.read_bytes() for path in run.rglob("*") if path.is_file()}
    longer = ["--steps", "8", "--resume", "true"]
    assert pretrain(tiny_pretraining_recipe, tmp_path / "other", run, *longer) == 2
    said = capsys.readouterr().err
    assert f"last.ckpt is of another dataset than {tmp_path / 'other'}; give that one" in said
    assert {path: path.read_bytes() for path in run.rglob("*") if path.is_file()} == before
    moved = shutil.copytree(tiny_dataset, tmp_path / "moved")
    assert pretrain(tiny_pretraining_recipe, moved, run, *longer) == 0


def test_an_export_that_was_cut_off_leaves_no_encoder_with_the_figures_of_an_earlier_one(
    tiny_encoder: Path,
    tiny_dataset: Path,
    tiny_pretraining_recipe: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
):
    def killed(self: RadianceField, folder: Path) -> None:
        raise RuntimeError("killed")

    out = tmp_path / "run"
    shutil.copytree(tiny_encoder, out)
    with monkeypatch.context() as patch:
        patch.setattr(RadianceField, "save", killed)
        assert pretrain(tiny_pretraining_recipe, tiny_dataset, out, "--resume", "true") == 1
    assert not (out / "summary.json").exists() and not (out / DESCRIPTION).exists()
    assert pretrain(tiny_pretraining_recipe, tiny_dataset, out, "--resume", "true") == 0
    assert (out / WEIGHTS).read_bytes() == (tiny_encoder / WEIGHTS).read_bytes()
    assert (out / "summary.json").exists() and (out / DESCRIPTION).exists()


def test_an_interruption_keeps_the_checkpoint_and_exits_with_130(
    tiny_dataset: Path,
    tiny_pretraining_recipe: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    interruptible: None,
    capsys: pytest.CaptureFixture[str],
):
    step = SnerlModule.training_step

    def interrupted(self: SnerlModule, *arguments: Any) -> Any:
        if self.global_step == 3:
            raise KeyboardInterrupt
        return step(self, *arguments)

    monkeypatch.setattr(SnerlModule, "training_step", interrupted)
    assert pretrain(tiny_pretraining_recipe, tiny_dataset, tmp_path / "run") == 130
    assert "nerf-rl pretrain: interrupted" in capsys.readouterr().err
    assert (tmp_path / "run" / "checkpoints" / "last.ckpt").is_file()
    assert not (tmp_path / "run" / "summary.json").exists()


def test_a_missing_dataset_is_refused_and_nothing_is_written(
    tiny_pretraining_recipe: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
):
    assert pretrain(tiny_pretraining_recipe, tmp_path / "nothing", tmp_path / "run") == 2
    message = capsys.readouterr().err
    assert "is not a dataset: the folder does not exist" in message and message.count("\n") == 1
    assert not list(tmp_path.iterdir())


def test_frames_that_are_held_out_are_not_said_to_be_trained_on(
    tiny_dataset: Path,
    tiny_pretraining_recipe: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
):
    monkeypatch.setattr("nerf_rl.pretrain.train.train", lambda config, checkpoint: None)
    assert pretrain(tiny_pretraining_recipe, tiny_dataset, tmp_path / "run") == 0
    kept, held = (len(MultiViewDataset(tiny_dataset).split(name)) for name in ("train", "validation"))
    assert held and f"training on {kept} frames of {tiny_dataset}, {held} more held out;" in capsys.readouterr().out


def test_a_dataset_that_does_not_suit_is_refused_and_nothing_is_written(
    tiny_dataset: Path,
    tiny_pretraining_recipe: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
):
    monkeypatch.setattr(MultiViewDataset, "split", lambda self, name: np.arange(12 if name == "train" else 0))
    assert pretrain(tiny_pretraining_recipe, tiny_dataset, tmp_path / "run") == 2
    said = capsys.readouterr().err
    assert "needs training and validation frames, two of each at least, and has 12 and 0; generate more" in said
    assert not list(tmp_path.iterdir())
    dataset = Path(shutil.copytree(tiny_dataset, tmp_path / "imported"))
    read = MultiViewDataset.__init__

    def imported(self: MultiViewDataset, folder: Path | str) -> None:
        read(self, folder)
        self.manifest["config"]["imported_from"] = "nerfstudio"

    monkeypatch.setattr(MultiViewDataset, "__init__", imported)
    assert pretrain(tiny_pretraining_recipe, dataset, tmp_path / "run") == 2
    assert "and has 12 and 0; import more moments, or hold out another share of them" in capsys.readouterr().err


def test_an_existing_run_is_refused_and_left_alone(
    tiny_encoder: Path, tiny_dataset: Path, tiny_pretraining_recipe: Path, capsys: pytest.CaptureFixture[str]
):
    before = {path: path.stat().st_mtime_ns for path in tiny_encoder.rglob("*")}
    assert pretrain(tiny_pretraining_recipe, tiny_dataset, tiny_encoder) == 2
    assert "already exists and is not empty; use --resume true, --overwrite true" in capsys.readouterr().err
    assert {path: path.stat().st_mtime_ns for path in tiny_encoder.rglob("*")} == before


@pytest.mark.parametrize(
    "keys, reason",
    [
        (["--sampling.far", "0.01"], "sampling needs 0 < near < far"),
        (["--sampling.near", "0.001", "--sampling.far", "0.01"], "nothing is nearer than --sampling.far 0.010"),
        (["--objective", "anchors", "--losses.anchor", "0"], "shows no class that moves"),
        (["--objective", "supervised"], "no column of the true state"),
        (["--encoder.patch", "25"], "--encoder.patch 25 is larger than images of 24 pixels"),
    ],
)
def test_what_cannot_be_learnt_from_costs_no_run_that_it_would_replace(
    tiny_encoder: Path,
    tiny_dataset: Path,
    tiny_pretraining_recipe: Path,
    tmp_path: Path,
    keys: list[str],
    reason: str,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
):
    monkeypatch.setattr(statistics, "choose_anchors", lambda *_: Anchors.of_nothing())
    monkeypatch.setattr(learnable, "standardised_state", lambda _: ([], np.zeros(0), np.zeros(0)))
    run = shutil.copytree(tiny_encoder, tmp_path / "run")
    before = sorted(run.rglob("*"))
    assert pretrain(tiny_pretraining_recipe, tiny_dataset, run, *keys, "--overwrite", "true") == 2
    assert reason in capsys.readouterr().err
    assert sorted(run.rglob("*")) == before
    assert pretrain(tiny_pretraining_recipe, tiny_dataset, tmp_path / "new", *keys) == 2
    assert not (tmp_path / "new").exists()


def test_an_unknown_teacher_is_answered_with_the_teachers(
    tiny_dataset: Path, tiny_pretraining_recipe: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
):
    assert pretrain(tiny_pretraining_recipe, tiny_dataset, tmp_path / "run", "--teachers", "[dino]") == 2
    assert "unknown teacher 'dino'; available: depth, normals" in capsys.readouterr().err
    assert not list(tmp_path.iterdir())
