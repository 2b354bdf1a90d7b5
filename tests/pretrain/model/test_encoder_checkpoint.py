"""A Lightning checkpoint used as an encoder: it carries what it needs, and its statistics belong to its weights."""

import json
import pickle
import shutil
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from safetensors.torch import load_file

from nerf_rl import cli
from nerf_rl.datasets.storage.reader import MultiViewDataset
from nerf_rl.errors import MissingFileError
from nerf_rl.files.tensor_files import write_tensors
from nerf_rl.pretrain.model.encoder import Encoder
from nerf_rl.pretrain.model.encoder_file import DESCRIPTION, WEIGHTS, read_description
from nerf_rl.pretrain.model.field import RadianceField
from nerf_rl.pretrain.objectives.snerl_module import SnerlModule

LAST = Path("checkpoints") / "last.ckpt"


def standardised(encoder: Encoder, dataset: MultiViewDataset) -> torch.Tensor:
    """Return the standardised latents of all training frames."""
    images = torch.from_numpy(dataset.read("rgb", dataset.split("train"))[:, dataset.views("encoder")])
    matrices = torch.from_numpy(encoder.rig.projections).expand(len(images), -1, -1, -1)
    return encoder.standardise(encoder(images, matrices))


def test_the_last_checkpoint_gives_the_latents_of_the_export(tiny_encoder: Path, tiny_dataset: Path):
    dataset = MultiViewDataset(tiny_dataset)
    exported, checkpoint = Encoder.load(tiny_encoder), Encoder.load(tiny_encoder / LAST)
    torch.testing.assert_close(standardised(checkpoint, dataset), standardised(exported, dataset), atol=1e-5, rtol=0)
    assert float(checkpoint.latent_std.sub(1).abs().min()) > 0 and float(checkpoint.latent_mean.abs().max()) > 0
    assert read_description(tiny_encoder / LAST)[1]["palette"] == read_description(tiny_encoder)[1]["palette"]


def test_a_checkpoint_of_a_run_that_was_cut_off_is_an_encoder_with_statistics_of_its_own_weights(
    tiny_dataset: Path, tiny_pretraining_recipe: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    step = SnerlModule.training_step

    def killed(self: SnerlModule, *arguments: Any) -> Any:
        if self.global_step == 3:  # after the first checkpoint
            raise RuntimeError("killed")
        return step(self, *arguments)

    monkeypatch.setattr(SnerlModule, "training_step", killed)
    arguments = ["--config", str(tiny_pretraining_recipe), "--data", str(tiny_dataset), "--out", str(tmp_path / "run")]
    assert cli.main(["pretrain", *arguments]) == 1
    assert not (tmp_path / "run" / DESCRIPTION).exists()
    alone = tmp_path / "alone.ckpt"
    shutil.copy(tmp_path / "run" / LAST, alone)
    encoder = Encoder.load(alone)
    assert encoder.scene == "metaworld/drawer-open-v3" and encoder.rig.names == ("left", "right")
    latents = standardised(encoder, MultiViewDataset(tiny_dataset)).numpy()
    np.testing.assert_allclose(latents.mean(0), 0.0, atol=1e-2)
    varying = encoder.latent_std.numpy() > 2e-4
    assert varying.any()
    np.testing.assert_allclose(latents.std(0)[varying], 1.0, atol=1e-2)


@pytest.fixture
def run(tiny_encoder: Path, tmp_path: Path) -> Path:
    """A copy of the tiny encoder's run, to damage."""
    return Path(shutil.copytree(tiny_encoder, tmp_path / "run"))


@pytest.mark.parametrize(
    ("is_older", "said"),
    [
        (True, "state_dict lacks field.frame_origins.units;"),
        (False, "state_dict has field.tomorrow, which this version"),
    ],
)
def test_a_run_of_another_version_is_not_gone_on_with(
    is_older: bool,
    said: str,
    run: Path,
    tiny_dataset: Path,
    tiny_pretraining_recipe: Path,
    capsys: pytest.CaptureFixture[str],
):
    """The sentence names what one of the two does not have."""
    content = torch.load(run / LAST, weights_only=True)
    if is_older:
        del content["state_dict"]["field.frame_origins.units"]
    else:
        content["state_dict"]["field.tomorrow"] = torch.zeros(1)
    torch.save(content, run / LAST)
    before = (run / LAST).read_bytes()
    words = ["--config", str(tiny_pretraining_recipe), "--data", str(tiny_dataset), "--out", str(run), "--steps", "99"]
    assert cli.main(["pretrain", *words, "--resume", "true"]) == 2
    told = capsys.readouterr().err
    assert said in told and told.count("\n") == 1 and len(told) < 400
    assert (run / LAST).read_bytes() == before


def test_a_checkpoint_of_old_without_statistics_is_refused(run: Path):
    content = torch.load(run / LAST, weights_only=True)
    del content["encoder"]
    torch.save(content, run / LAST)
    with pytest.raises(
        MissingFileError, match=r"does not say what its encoder's latents are standardised by.*run fold"
    ):
        Encoder.load(run / LAST)


class Payload:
    """What an unpickler that executes code would call."""

    def __init__(self, marker: Path):
        self._marker = marker

    def __reduce__(self) -> tuple[Any, ...]:
        return Path.touch, (self._marker,)


def test_a_checkpoint_that_would_execute_code_is_refused(run: Path, tmp_path: Path):
    torch.save({"state_dict": {}, "encoder": Payload(tmp_path / "marker")}, run / LAST)
    pickled = pickle.dumps(Payload(tmp_path / "marker"))
    for content in ((run / LAST).read_bytes(), pickled):
        (run / LAST).write_bytes(content)
        with pytest.raises(MissingFileError, match="is damaged, or holds more than tensors and plain values"):
            Encoder.load(run / LAST)
    assert not (tmp_path / "marker").exists()


def test_a_changed_byte_of_a_weight_is_found(run: Path):
    with zipfile.ZipFile(run / LAST) as archive:
        record = max(archive.infolist(), key=lambda record: record.file_size)
    content = bytearray((run / LAST).read_bytes())
    content[record.header_offset + 200 + record.file_size // 2] ^= 1
    (run / LAST).write_bytes(content)
    with pytest.raises(MissingFileError, match="is damaged"):
        Encoder.load(run / LAST)


@pytest.mark.parametrize(
    "name, load, format, readable",
    [("encoder", Encoder.load, 3, "2 and 3"), ("field", RadianceField.load, 4, "2, 3 and 4")],
)
def test_an_unknown_format_is_told(run: Path, name: str, load: Any, format: int, readable: str):
    path = run / f"{name}.json"
    description = json.loads(path.read_text())
    assert description["format"] == format
    for unknown in (1, format + 1, "2", None, True):
        path.write_text(json.dumps(description | {"format": unknown, "new": "key"}))
        with pytest.raises(MissingFileError, match=rf"format.* is {unknown!r}, this version reads {readable};"):
            load(run)


@pytest.mark.parametrize("name, load", [("encoder", Encoder.load), ("field", RadianceField.load)])
def test_a_description_of_old_without_a_format_is_told_apart(run: Path, name: str, load: Any):
    """Its weights have today's shapes but another meaning."""
    description = json.loads((run / f"{name}.json").read_text())
    del description["format"]
    (run / f"{name}.json").write_text(json.dumps(description))
    with pytest.raises(MissingFileError, match=r"format|version"):
        load(run)


@pytest.mark.parametrize(
    "keys, value, fault",
    [
        (("architecture", "hidden"), 10**9, "architecture.hidden is 1000000000 instead of a whole number"),
        (("architecture", "hidden"), 10**6, "its description makes no network (--encoder.hidden must be at most"),
        (("architecture", "hidden"), 10**4, "per_view.0.weight has the shape"),
        (("architecture", "landmarks"), 1, "architecture.landmarks is 1 instead of"),
        (("architecture", "wings"), 2, "architecture.wings is 2 instead of nothing: known are latent"),
        (("architecture", "patch"), 100, "its description makes no network"),
        (("rig", "height"), "24", "rig.height is '24' instead of a whole number"),
        (("rig", "intrinsics"), [[1, 2], [3]], "rig.intrinsics.0 is a list of 2 instead of a list of 3"),
        (("rig", "names"), ["left"], "its cameras have different numbers of names, intrinsics and poses"),
        (("scene", "quality"), "best", "scene.quality is 'best' instead of one of fast, smooth, full"),
    ],
)
def test_a_description_that_does_not_fit_is_told_before_anything_is_allocated(
    run: Path, keys: tuple[str, str], value: Any, fault: str
):
    description = json.loads((run / DESCRIPTION).read_text())
    description[keys[0]][keys[1]] = value
    (run / DESCRIPTION).write_text(json.dumps(description))
    with pytest.raises(MissingFileError) as refusal:
        Encoder.load(run)
    assert fault in str(refusal.value)


def test_statistics_that_nothing_can_be_divided_by_are_told(run: Path):
    tensors = load_file(run / WEIGHTS)
    tensors["latent_std"][3] = 0.0
    write_tensors(run / WEIGHTS, tensors)
    with pytest.raises(MissingFileError, match="a deviation of its latents is not positive; train it again"):
        Encoder.load(run)
