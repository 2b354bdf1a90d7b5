"""bfloat16 and float32: both train with the shipped recipes, and what z is made of keeps its precision."""

import json
import math
from pathlib import Path

import pytest
import torch

from nerf_rl import cli
from nerf_rl.pretrain.model.encoder import Encoder
from nerf_rl.pretrain.model.precision import resolve_precision

CPU, CUDA = torch.device("cpu"), torch.device("cuda", 0)
RECIPES = Path(__file__).parents[3] / "pretrain"
# all else is as shipped
FEWER = {  # of 64 + 192 samples a ray, each through 8 x 256 units
    "snerl-original.yaml": [
        *("--rays_per_scene", "16"),
        *("--sampling.rendering_stratified", "4", "--sampling.rendering_importance", "2"),
    ]
}
SHRUNK = ["--steps", "4", "--steps_per_epoch", "2", "--validation_frames", "2", "--probe_frames", "9"]


@pytest.mark.parametrize("chosen", ["32", "bf16"])
@pytest.mark.parametrize("recipe", sorted(path.name for path in RECIPES.glob("*.yaml")))
def test_a_shipped_recipe_trains_to_its_end_in_either_precision(
    recipe: str, chosen: str, tiny_dataset: Path, tmp_path: Path
):
    out = tmp_path / "run"
    words = ["--config", str(RECIPES / recipe), "--data", str(tiny_dataset), "--out", str(out), *SHRUNK]
    words += FEWER.get(recipe, [])
    assert cli.main(["pretrain", *words, "--precision", chosen]) == 0
    summary = json.loads((out / "summary.json").read_text())
    assert summary["precision"] == chosen and summary["steps"] == 4
    assert all(math.isfinite(value) for value in summary["validation"].values())
    assert all(bool(torch.isfinite(p).all()) for p in Encoder.load(out).parameters())


@pytest.mark.parametrize(("tiles", "vectors"), [(False, False), (True, False), (False, True), (True, True)])
def test_auto_is_bfloat16_where_it_was_measured_to_train_better(
    tiles: bool, vectors: bool, monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.setattr(torch.cpu, "_is_amx_tile_supported", lambda: tiles)
    monkeypatch.setattr(torch.cpu, "_is_avx512_bf16_supported", lambda: vectors)
    monkeypatch.setattr(torch.cuda, "is_bf16_supported", lambda *_, **__: True)  # it says so of GPUs that emulate it
    assert resolve_precision("auto", CPU) == ("bf16" if tiles or vectors else "32")
    assert resolve_precision("auto", CUDA) == "32"
    assert [resolve_precision(name, CPU) for name in ("32", "bf16")] == ["32", "bf16"]


def test_latents_that_hardly_differ_are_told_apart_in_bfloat16(tiny_encoder: Path):
    """Early in training they do; rounded to eight bits, z would have a few values for all frames."""
    encoder = Encoder.load(tiny_encoder)
    rig = encoder.rig
    generator = torch.Generator().manual_seed(0)
    shape = (32, len(rig.names), rig.height, rig.width, 3)
    images = 100 + torch.randint(16, shape, generator=generator, dtype=torch.uint8)
    matrices = torch.from_numpy(rig.projections).expand(32, -1, -1, -1)
    with torch.autocast("cpu", torch.bfloat16):
        latent = encoder(images, matrices)
    assert latent.dtype == torch.float32
    assert [len(column.unique()) for column in latent.T] == [32] * encoder.latent_size
