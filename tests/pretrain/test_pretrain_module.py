"""What a run's module makes of its configuration: figures of a validation, schedules, and the budget of time."""

import dataclasses
import itertools
import json
import math
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import torch

from nerf_rl import cli
from nerf_rl.datasets.storage.reader import MultiViewDataset
from nerf_rl.pretrain.config import PretrainConfig
from nerf_rl.pretrain.data.batches import RayBatches
from nerf_rl.pretrain.data.statistics import measure
from nerf_rl.pretrain.measures.figures import describe_iou
from nerf_rl.pretrain.model.encoder_rig import EncoderRig
from nerf_rl.pretrain.objectives import encoder_module
from nerf_rl.pretrain.objectives.snerl_module import SnerlModule


def pretrain(recipe: Path, data: Path, out: Path, *arguments: str) -> int:
    return cli.main(["pretrain", "--config", str(recipe), "--data", str(data), "--out", str(out), *arguments])


def make_module(data: Path, recipe: Path, **settings: Any) -> SnerlModule:
    parsed: PretrainConfig = cli.parse("pretrain", ["--config", str(recipe), "--data", str(data), "--out", "unused"])
    config, dataset = dataclasses.replace(parsed, **settings), MultiViewDataset(data)
    return SnerlModule(config, dataset, measure(dataset, config), EncoderRig.of_dataset(dataset))


def test_a_class_that_is_neither_shown_nor_rendered_has_no_iou(
    tiny_dataset: Path, tiny_pretraining_recipe: Path, monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.setattr(SnerlModule, "log_dict", lambda *_, **__: None)
    monkeypatch.setattr(SnerlModule, "global_step", 7)
    names = MultiViewDataset.class_names.fget(MultiViewDataset(tiny_dataset))  # type: ignore[attr-defined]
    monkeypatch.setattr(MultiViewDataset, "class_names", property(lambda _: (*names, "nowhere")))
    module = make_module(tiny_dataset, tiny_pretraining_recipe)
    torch.nn.init.constant_(module.field.semantic_head.bias[-1:], -1e4)
    for frame in module._dataset.split("validation"):
        module.validation_step(int(frame), 0)
    module.on_validation_epoch_end()
    assert module.class_iou["nowhere"] is None
    known = [value for name, value in module.class_iou.items() if name in names and value is not None]
    assert module.validation["miou"] == pytest.approx(sum(known) / len(known))
    json.dumps({"class_iou": module.class_iou, **module.validation}, allow_nan=False)
    assert describe_iou(module.class_iou["nowhere"]) == "unknown"


def test_the_learning_rate_rises_and_then_falls_along_a_cosine(
    tiny_dataset: Path, tiny_pretraining_recipe: Path, monkeypatch: pytest.MonkeyPatch
):
    module = make_module(tiny_dataset, tiny_pretraining_recipe, steps=1000)
    factors = []
    for step in range(0, 1001):
        monkeypatch.setattr(SnerlModule, "global_step", step)
        factors.append(module.learning_rate_factor())
    peak = int(np.argmax(factors))
    assert factors[peak] == pytest.approx(1.0, abs=1e-3) and 20 <= peak <= 40
    assert (np.diff(factors[: peak + 1]) > 0).all() and (np.diff(factors[peak:]) < 0).all()
    assert factors[-1] == pytest.approx(0.02, abs=1e-6)
    middle = peak + (1000 - peak) // 2
    assert factors[middle] == pytest.approx(0.02 + 0.98 * (0.5 + 0.5 * math.cos(math.pi / 2)), abs=2e-3)


def test_training_sharpens_the_field_up_to_the_share_asked_for(
    tiny_dataset: Path, tiny_pretraining_recipe: Path, monkeypatch: pytest.MonkeyPatch
):
    module = make_module(tiny_dataset, tiny_pretraining_recipe, steps=1000, coarse_to_fine=0.5)
    monkeypatch.setattr(SnerlModule, "log_dict", lambda *_, **__: None)
    monkeypatch.setattr(SnerlModule, "log", lambda *_, **__: None)
    batch = RayBatches(module._dataset, module.config, measure(module._dataset, module.config))[0]
    weights = []
    for step in (0, 100, 250, 400, 500, 999):
        monkeypatch.setattr(SnerlModule, "global_step", step)
        module.training_step(batch, step)
        weights.append(float(module.field.octave_weights.sum()))
    octaves = module.config.radiance_field.frequencies
    assert weights[0] == 2.0 and weights[-2:] == [octaves, octaves]
    assert (np.diff(weights[:-1]) > 0).all()


def test_a_budget_of_time_ends_the_schedule_before_the_steps_do(
    tiny_dataset: Path, tiny_pretraining_recipe: Path, monkeypatch: pytest.MonkeyPatch
):
    module = make_module(tiny_dataset, tiny_pretraining_recipe, steps=1000, max_minutes=2.0)
    monkeypatch.setattr(SnerlModule, "global_step", 250)
    assert module.progress() == 0.25
    module.seconds = 90.0
    assert (module.progress(), module.seconds_left()) == (0.75, 30.0)
    module.seconds = 500.0
    assert (module.progress(), module.seconds_left()) == (1.0, 0.0)
    assert module.learning_rate_factor() == pytest.approx(0.02)


def test_a_budget_of_time_that_is_not_short_changes_nothing(
    tiny_dataset: Path, tiny_pretraining_recipe: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    encoders = set()
    for seconds, minutes in ((1.0, "null"), (1.0, "30"), (4.0, "30")):  # between two looks at the clock
        clock = itertools.count(0.0, seconds)
        monkeypatch.setattr(encoder_module, "time", SimpleNamespace(monotonic=clock.__next__))
        keys, out = ["--max_minutes", minutes, "--coarse_to_fine", "0.4"], tmp_path / f"{seconds}-{minutes}"
        assert pretrain(tiny_pretraining_recipe, tiny_dataset, out, *keys) == 0
        encoders.add((out / "encoder.safetensors").read_bytes())
    assert len(encoders) == 1


def test_a_budget_of_time_is_of_training_and_not_of_validations(
    tiny_dataset: Path, tiny_pretraining_recipe: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    now, validate = [0.0], SnerlModule.validation_step

    def slowly(module: SnerlModule, frame: int, step: int) -> None:
        now[0] += 1000.0
        validate(module, frame, step)

    monkeypatch.setattr(encoder_module, "time", SimpleNamespace(monotonic=lambda: now[0]))
    monkeypatch.setattr(SnerlModule, "validation_step", slowly)
    keys = ["--steps", "4", "--steps_per_epoch", "2", "--epochs_per_validation", "1", "--max_minutes", "1"]
    assert pretrain(tiny_pretraining_recipe, tiny_dataset, tmp_path / "run", *keys) == 0
    summary = json.loads((tmp_path / "run" / "summary.json").read_text())
    assert now[0] >= 2000 and summary["steps"] == 4 and summary["training_seconds"] == 0
