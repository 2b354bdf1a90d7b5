"""The encoder: what z depends on, and the artefact that holds it."""

import inspect
import json
import shutil
import subprocess
import sys
import warnings
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import torch

from nerf_rl.cameras import geometry as cameras
from nerf_rl.errors import MissingFileError, UserError
from nerf_rl.pretrain.config import EncoderConfig
from nerf_rl.pretrain.model.encoder import Encoder
from nerf_rl.pretrain.model.encoder_file import DESCRIPTION, WEIGHTS
from nerf_rl.pretrain.model.encoder_rig import EncoderRig

NAMES = ("left", "right", "top")


def make_rig(names: tuple[str, ...] = NAMES, size: int = 16) -> EncoderRig:
    poses = [cameras.look_at(np.array([0.0, 0.6, 0.1]), 0.9, 20.0 + 60 * i, -30.0) for i in range(len(names))]
    intrinsics = np.stack([cameras.intrinsics_from_fovy(45.0, size, size)] * len(names))
    return EncoderRig(names, intrinsics, np.stack(poses), size, size)


def make_encoder() -> Encoder:
    torch.manual_seed(0)
    return Encoder(EncoderConfig(latent=6, channels=[8, 12], hidden=16), make_rig()).eval()


def inputs(scenes: int = 2) -> tuple[torch.Tensor, torch.Tensor]:
    """Return random images and the rig's matrices."""
    generator = torch.Generator().manual_seed(1)
    images = torch.randint(256, (scenes, 3, 16, 16, 3), dtype=torch.uint8, generator=generator)
    return images, torch.from_numpy(make_rig().projections).expand(scenes, -1, -1, -1)


@torch.no_grad()
def test_the_order_of_views_does_not_matter():
    encoder, (images, projections) = make_encoder(), inputs()
    order = [2, 0, 1]
    torch.testing.assert_close(encoder(images[:, order], projections[:, order]), encoder(images, projections))


@torch.no_grad()
def test_encoding_takes_the_cameras_from_the_encoders_own_rig():
    encoder, (images, projections) = make_encoder(), inputs()
    torch.testing.assert_close(encoder.encode(images), encoder(images, projections), atol=0, rtol=0)
    torch.testing.assert_close(encoder.encode(images.numpy()), encoder.encode(images), atol=0, rtol=0)


@pytest.mark.parametrize(
    "change, got",
    [
        (lambda images: images[:, :2], "uint8 [2, 2, 16, 16, 3]"),
        (lambda images: images[:, :, :15], "uint8 [2, 3, 15, 16, 3]"),
        (lambda images: images[:, :, :, :15], "uint8 [2, 3, 16, 15, 3]"),
        (lambda images: images[0], "uint8 [3, 16, 16, 3]"),
        (lambda images: images / 255.0, "float32 [2, 3, 16, 16, 3]"),
    ],
)
def test_images_that_are_not_what_the_cameras_see_are_refused(change: Callable, got: str):
    encode = inspect.unwrap(Encoder.encode)  # as it is outside of tests, where nothing checks annotations
    with pytest.raises(UserError) as refused:
        encode(make_encoder(), change(inputs()[0]))
    told = "the encoder takes uint8 [B, 3, 16, 16, 3] (3 cameras, 16 pixels high and 16 wide), got"
    assert str(refused.value) == f"{told} {got}"


def test_images_are_read_whatever_their_strides_and_whoever_may_write_to_them():
    encoder, images = make_encoder(), inputs()[0].numpy()
    mirrored = np.ascontiguousarray(images[..., ::-1])
    expected = encoder.encode(mirrored)
    mirrored.flags.writeable = False
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        for same in (images[..., ::-1], mirrored):
            assert torch.equal(encoder.encode(same), expected)
    assert not torch.equal(encoder.encode(images), expected)


def test_pictures_of_no_moment_are_refused():
    with pytest.raises(UserError, match="pictures of one moment at least"):
        make_encoder().encode(inputs()[0][:0])


def test_it_matters_which_camera_an_image_came_from():
    encoder, (images, projections) = make_encoder(), inputs()
    z, swapped = encoder(images, projections), encoder(images[:, [1, 0, 2]], projections)
    assert float((z - swapped).abs().max()) > 1e-3


@torch.no_grad()
def test_z_depends_on_every_view_and_on_its_own_scene_alone():
    encoder, (images, projections) = make_encoder(), inputs()
    z = encoder(images, projections)
    for view in range(3):
        changed = images.clone()
        changed[0, view] = 255 - changed[0, view]
        other = encoder(changed, projections)
        assert float((other[0] - z[0]).abs().max()) > 1e-3
        torch.testing.assert_close(other[1], z[1])
    assert z.shape == (2, encoder.latent_size) == (2, 6)


def test_gradients_reach_every_weight():
    encoder, (images, projections) = make_encoder(), inputs()
    (encoder(images, projections) ** 2).sum().backward()
    for name, parameter in encoder.named_parameters():
        assert parameter.grad is not None and parameter.grad.abs().sum() > 0, name


def test_standardised_latents_have_zero_mean_and_unit_deviation():
    encoder = make_encoder()
    latents = torch.randn((500, 6), generator=torch.Generator().manual_seed(2)) * 3 + 5
    encoder.latent_mean.copy_(latents.mean(0))
    encoder.latent_std.copy_(latents.std(0, correction=0))
    standard = encoder.standardise(latents)
    torch.testing.assert_close(standard.mean(0), torch.zeros(6), atol=1e-5, rtol=0)
    torch.testing.assert_close(standard.std(0, correction=0), torch.ones(6))


@torch.no_grad()
def test_a_stored_encoder_is_the_same_encoder_and_frozen(tmp_path: Path):
    encoder, (images, projections) = make_encoder(), inputs()
    encoder.scene, encoder.quality = "metaworld/drawer-open-v3", "full"
    encoder.latent_mean.fill_(0.5)
    encoder.save(tmp_path, {"classes": ["background"]})
    loaded = Encoder.load(tmp_path)
    torch.testing.assert_close(loaded(images, projections), encoder(images, projections), atol=0, rtol=0)
    torch.testing.assert_close(loaded.latent_mean, encoder.latent_mean)
    assert (loaded.scene, loaded.quality, loaded.config) == (encoder.scene, encoder.quality, encoder.config)
    loaded.rig.require_same(encoder.rig)
    np.testing.assert_array_equal(loaded.rig.projections, encoder.rig.projections)
    assert not loaded.training and not any(parameter.requires_grad for parameter in loaded.parameters())
    assert json.loads((tmp_path / DESCRIPTION).read_text())["classes"] == ["background"]


def test_the_artefact_holds_safetensors_and_json_and_is_read_without_pickle(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    make_encoder().save(tmp_path, {})
    assert sorted(path.name for path in tmp_path.iterdir()) == [DESCRIPTION, WEIGHTS]

    def refuse(*_: object, **__: object) -> None:
        raise AssertionError("unpickled")

    monkeypatch.setattr(torch, "load", refuse)
    monkeypatch.setattr("pickle.load", refuse)
    Encoder.load(tmp_path)
    header_length = int.from_bytes((tmp_path / WEIGHTS).read_bytes()[:8], "little")
    json.loads((tmp_path / WEIGHTS).read_bytes()[8 : 8 + header_length])


def test_an_encoder_is_found_by_its_folder_its_files_and_its_checkpoint(tiny_encoder: Path):
    expected = Encoder.load(tiny_encoder).state_dict()
    for path in (tiny_encoder / WEIGHTS, tiny_encoder / DESCRIPTION, tiny_encoder / "checkpoints" / "last.ckpt"):
        found = Encoder.load(str(path)).state_dict()
        assert set(found) == set(expected)
        for name, value in expected.items():
            if not name.startswith("latent_"):  # measured after the last checkpoint
                assert torch.equal(found[name], value), (path, name)


def test_a_path_that_does_not_exist_is_told_with_a_remedy(tmp_path: Path):
    with pytest.raises(MissingFileError, match="is not an encoder: it does not exist; make one with: nerf-rl pretrain"):
        Encoder.load(tmp_path / "nothing")


@pytest.mark.parametrize("missing", [WEIGHTS, DESCRIPTION])
def test_half_an_artefact_is_no_encoder(tmp_path: Path, missing: str):
    make_encoder().save(tmp_path, {})
    (tmp_path / missing).unlink()
    with pytest.raises(MissingFileError, match=r"there is no encoder\.json with its encoder\.safetensors"):
        Encoder.load(tmp_path)


@pytest.mark.parametrize("content", ["{", "[]", '{"format": 2, "rig": {}}'])
def test_a_damaged_description_is_told_as_such(tmp_path: Path, content: str):
    make_encoder().save(tmp_path, {})
    (tmp_path / DESCRIPTION).write_text(content)
    with pytest.raises(MissingFileError, match=r"its encoder\.json is damaged"):
        Encoder.load(tmp_path)


def test_an_exported_encoder_is_all_that_is_needed(tiny_encoder: Path, tmp_path: Path):
    for name in (WEIGHTS, DESCRIPTION):
        shutil.copy(tiny_encoder / name, tmp_path / name)
    encoder = Encoder.load(tmp_path)
    assert encoder.rig.names == ("left", "right") and encoder.rig.height == encoder.rig.width == 24
    assert encoder.scene == "metaworld/drawer-open-v3" and encoder.latent_size == 8
    assert float(encoder.latent_std.min()) > 0 and float(encoder.latent_mean.abs().max()) > 0


@pytest.mark.parametrize(("size", "patch", "channels"), [(16, 4, [8]), (17, 3, [4, 8, 8]), (30, 5, [4, 4, 4, 4])])
@torch.no_grad()
def test_images_of_any_size_are_encoded(size: int, patch: int, channels: list[int]):
    rig = make_rig(size=size)
    encoder = Encoder(EncoderConfig(latent=6, patch=patch, channels=channels, hidden=16), rig, landmarks=2)
    images = torch.zeros(2, 3, size, size, 3, dtype=torch.uint8)
    assert encoder.encode(images).shape == (2, 6)


def test_images_smaller_than_a_patch_are_refused_in_a_sentence():
    with pytest.raises(UserError, match=r"--encoder\.patch 32 is larger than images of 16 pixels"):
        Encoder(EncoderConfig(patch=32), make_rig())


def test_artefacts_are_loaded_without_the_compiler_of_pytorch(tiny_encoder: Path, tiny_agent: Path):
    """Every process that acts loads some: importing the compiler takes seconds and a hundred megabytes each time."""
    program = (
        "import sys, pathlib; from nerf_rl.pretrain.model.encoder import Encoder;"
        "from nerf_rl.pretrain.model.field import RadianceField; from nerf_rl.rl.agents.policy import Policy;"
        "folder = pathlib.Path(sys.argv[1]); Encoder.load(folder); RadianceField.load(folder);"
        "Policy.load(pathlib.Path(sys.argv[2])); sys.exit('torch._dynamo' in sys.modules)"
    )
    subprocess.run([sys.executable, "-c", program, str(tiny_encoder), str(tiny_agent)], check=True)
