"""Encoders that something else than a radiance field teaches: recipes, what they learn, what they refuse."""

import json
from dataclasses import replace
from pathlib import Path
from typing import Any, get_args

import pytest
import torch

from nerf_rl import cli
from nerf_rl.arguments.parsing import parse_config
from nerf_rl.datasets.storage.reader import MultiViewDataset
from nerf_rl.errors import UserError
from nerf_rl.pretrain import config as names
from nerf_rl.pretrain.config import EncoderConfig, LossConfig, PretrainConfig
from nerf_rl.pretrain.data.anchors import Anchors
from nerf_rl.pretrain.data.batches import RayBatches
from nerf_rl.pretrain.data.statistics import measure
from nerf_rl.pretrain.data.view_batches import ViewBatch, ViewBatches
from nerf_rl.pretrain.model.encoder import Encoder
from nerf_rl.pretrain.model.encoder_rig import EncoderRig
from nerf_rl.pretrain.objectives.picture_module import PictureModule
from nerf_rl.pretrain.objectives.picture_objectives import OBJECTIVES, MaskedAutoencoder, PictureDecoder, shifted

ROOT = Path(__file__).parents[3] / "pretrain"
DEMO, RECIPES = str(ROOT / "demo.yaml"), sorted((ROOT / "objectives").glob("*.yaml"))
SMALL = ["--steps", "4", "--steps_per_epoch", "2", "--scenes_per_step", "4", "--rays_per_scene", "8"]
SMALL += ["--validation_frames", "2", "--probe_frames", "9", "--threads", "1"]


@pytest.fixture(scope="module")
def batch(tiny_dataset: Path) -> ViewBatch:
    dataset = MultiViewDataset(tiny_dataset)
    config = PretrainConfig("data", "out", objective="anchors", scenes_per_step=8)
    return ViewBatches(dataset, config, measure(dataset, config))[0]


@pytest.fixture
def encoder(tiny_dataset: Path) -> Encoder:
    torch.manual_seed(0)
    dataset = MultiViewDataset(tiny_dataset)
    anchors = measure(dataset, PretrainConfig("data", "out")).anchors
    rig = EncoderRig.of_dataset(dataset)
    encoder = Encoder(EncoderConfig(latent=8, channels=[8, 16], hidden=16), rig, len(anchors.classes))
    assert encoder.landmarks is not None
    encoder.landmarks.place(torch.from_numpy(anchors.mean), torch.from_numpy(anchors.spread))
    return encoder


def pretrain(data: Path, out: Path, *arguments: str) -> int:
    return cli.main(["pretrain", "--config", DEMO, *arguments, "--data", str(data), "--out", str(out)])


def test_every_objective_has_a_name_and_a_recipe():
    assert set(get_args(names.Objective)) == {names.FIELD, names.RANDOM, *OBJECTIVES}
    named = {recipe.stem for recipe in RECIPES if not recipe.stem.startswith("field-")}
    assert named == {names.RANDOM, *OBJECTIVES}


@pytest.mark.parametrize("recipe", RECIPES, ids=lambda recipe: recipe.stem)
def test_a_recipe_ends_in_an_encoder_with_its_probe(recipe: Path, tiny_dataset: Path, tmp_path: Path):
    assert pretrain(tiny_dataset, tmp_path / "run", "--config", str(recipe), *SMALL) == 0
    summary = json.loads((tmp_path / "run/summary.json").read_text())
    is_field = recipe.stem.startswith("field-")
    assert summary["steps"] == (0 if recipe.stem == names.RANDOM else 4)
    assert bool(summary["validation"]) == is_field == (tmp_path / "run/field.safetensors").exists()
    assert summary["probe"]["hand_x"]["rmse_mm"] > 0
    assert Encoder.load(tmp_path / "run").latent_size == 128
    described = json.loads((tmp_path / "run/encoder.json").read_text())
    assert described["objective"] == ("field" if is_field else recipe.stem)
    if recipe.stem == names.RANDOM:
        assert summary["probe"] == summary["probe_random_encoder"]


def test_recipes_differ_from_the_demos_in_what_they_name_alone():
    def keys(*recipes: str) -> dict:
        words = [word for recipe in recipes for word in ("--config", recipe)]
        return parse_config(PretrainConfig, "pretrain", "", [*words, "--data", "d", "--out", "o"]).content()

    demo, autoencoder = keys(DEMO), keys(DEMO, str(ROOT / "objectives" / "autoencoder.yaml"))
    assert {key for key in demo if demo[key] != autoencoder[key]} == {"objective"}


@pytest.mark.parametrize("name", OBJECTIVES)
def test_an_objective_learns_and_its_seed_decides_it(name: str, encoder: Encoder, batch: ViewBatch):
    torch.manual_seed(1)
    objective = OBJECTIVES[name](encoder, batch.state.shape[1], batch.seen.shape[1])
    parameters = [value for value in (*encoder.parameters(), *objective.parameters()) if value.requires_grad]
    optimiser = torch.optim.Adam(parameters, lr=3e-3)

    def loss(seed: int) -> torch.Tensor:
        return sum(objective(encoder, batch, torch.Generator().manual_seed(seed)).values(), start=torch.zeros(()))

    before = loss(0).item()
    for step in range(150):
        optimiser.zero_grad()
        loss(step).backward()
        optimiser.step()
    assert loss(0).item() < 0.8 * before
    assert all(value.grad is not None for value in encoder.parameters())
    if name in ("masked", "contrastive"):
        assert loss(0).item() != loss(1).item()


@pytest.mark.parametrize(("height", "width", "patch"), [(64, 64, 4), (51, 46, 4), (7, 33, 1), (30, 17, 8)])
def test_every_pixel_of_any_size_is_painted_from_the_latent(encoder: Encoder, height: int, width: int, patch: int):
    rig = replace(encoder.rig, height=height, width=width)
    decoder = PictureDecoder(Encoder(EncoderConfig(latent=8, patch=patch, channels=[8, 16, 16]), rig), channels=2)
    painted = decoder(torch.randn(16, 8))
    assert painted.shape == (16, len(rig.names), 2, height, width)
    assert painted.std(0).min() > 0


def test_what_is_hidden_never_reaches_the_encoder(encoder: Encoder, batch: ViewBatch):
    """One view is hidden whole and half of the others; only the hidden pixels count."""
    objective, seen = MaskedAutoencoder(encoder, 1, 1), []
    encoder.register_forward_pre_hook(lambda _, words: seen.append(words[0]))
    losses = objective(encoder, batch, torch.Generator().manual_seed(0))
    hidden = (seen[0] == 128).all(-1)
    assert (seen[0][~hidden] == batch.images[~hidden]).all()
    share = hidden.float().mean((2, 3))
    assert ((share == 1.0).sum(1) >= 1).all() and 0.6 < hidden.float().mean() < 0.9
    painted = objective.decoder(encoder(seen[0], batch.projections))
    error = ((painted - batch.images.movedim(-1, 2) / 255.0) ** 2).mean(2)
    torch.testing.assert_close(losses["rgb"], error[hidden].mean(), rtol=1e-3, atol=1e-5)


def test_shifts_move_each_image_by_its_own_and_repeat_edges():
    row, column = torch.meshgrid(torch.arange(32), torch.arange(32), indexing="ij")
    places = torch.stack([row, column, torch.zeros_like(row)], -1).to(torch.uint8)
    moved = shifted(places.expand(5, 2, 32, 32, 3), torch.Generator().manual_seed(0)).flatten(0, 1).int()
    offsets = [tuple((image[16, 16, :2] - 16).tolist()) for image in moved]
    assert max(abs(part) for offset in offsets for part in offset) == 2 and len(set(offsets)) > 4
    for image, (down, right) in zip(moved, offsets, strict=True):
        assert torch.equal(image[..., 0], (row + down).clamp(0, 31).int())
        assert torch.equal(image[..., 1], (column + right).clamp(0, 31).int())


def test_batches_of_views_are_of_the_frames_that_the_field_would_see(tiny_dataset: Path):
    dataset = MultiViewDataset(tiny_dataset)
    config = PretrainConfig("data", "out", scenes_per_step=3)
    statistics = measure(dataset, config)
    views, rays = ViewBatches(dataset, config, statistics)[7], RayBatches(dataset, config, statistics)[7]
    assert torch.equal(views.images, rays.images) and torch.equal(views.projections, rays.projections)
    assert views.depth.min() >= 0 and views.depth.max() <= 1 and views.depth.std() > 0.05
    state = torch.cat([ViewBatches(dataset, config, statistics)[step].state for step in range(40)])
    assert state.mean(0).abs().max() < 0.5 and state.std(0).min() > 0.6 and state.std(0).max() < 1.5


def test_places_of_classes_are_those_that_the_field_would_be_pulled_to(tiny_dataset: Path):
    """In units of how far each moves; whoever learns from something else does not wait for them."""
    dataset = MultiViewDataset(tiny_dataset)
    config = PretrainConfig("data", "out", objective="anchors", losses=LossConfig(anchor=0.0), scenes_per_step=6)
    statistics = measure(dataset, config)
    views, rays = ViewBatches(dataset, config, statistics)[3], RayBatches(dataset, config, statistics)[3]
    mean, spread = (torch.from_numpy(value).float() for value in (statistics.anchors.mean, statistics.anchors.spread))
    assert views.seen.any() and torch.equal(views.seen, rays.seen)
    torch.testing.assert_close((views.middles * spread[:, None] + mean)[views.seen], rays.middles[views.seen])
    assert torch.equal(views.shares, rays.shares) and views.shares.shape[2] == 1 + len(spread)
    others = ViewBatches(dataset, replace(config, objective="depth"), statistics)[3]
    assert others.middles.shape == (6, 0, 3) and others.shares.numel() == 0


def test_places_of_classes_need_one_that_moves(tiny_dataset: Path):
    dataset = MultiViewDataset(tiny_dataset)
    config = PretrainConfig("data", "out", objective="anchors")
    still = measure(dataset, config)._replace(anchors=Anchors.of_nothing())
    with pytest.raises(UserError, match="shows no class that moves, which --objective anchors learns from"):
        PictureModule(config, dataset, still, EncoderRig.of_dataset(dataset))


def test_an_objective_that_was_killed_resumes_to_the_same_bits(
    tiny_dataset: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    """The key encoder and the similarity of contrastive learning come back as they were."""
    keys = ["--config", str(ROOT / "objectives" / "contrastive.yaml"), *SMALL, "--max_minutes", "null"]
    assert pretrain(tiny_dataset, tmp_path / "whole", *keys) == 0
    step = PictureModule.training_step

    def killed(self: PictureModule, *arguments: Any) -> Any:
        if self.global_step == 3:  # after the first checkpoint, before the second
            raise RuntimeError("killed")
        return step(self, *arguments)

    with monkeypatch.context() as patch:
        patch.setattr(PictureModule, "training_step", killed)
        assert pretrain(tiny_dataset, tmp_path / "parts", *keys) == 1
    torch.manual_seed(123)
    assert pretrain(tiny_dataset, tmp_path / "parts", *keys, "--resume", "true") == 0
    whole, parts = ((tmp_path / name / "encoder.safetensors").read_bytes() for name in ("whole", "parts"))
    assert whole == parts


def test_mistakes_are_told(tiny_dataset: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    assert pretrain(tiny_dataset, tmp_path / "run", "--objective", "autoencodr") == 2
    assert "'autoencodr'" in (told := capsys.readouterr().err) and "autoencoder" in told
    assert pretrain(tiny_dataset, tmp_path / "run", "--objective", "masked", "--devices", "2") == 2
    assert "--objective masked is trained on one device" in capsys.readouterr().err
    assert not (tmp_path / "run").exists()
