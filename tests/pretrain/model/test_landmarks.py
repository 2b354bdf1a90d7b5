"""Landmarks: middles of masks, where views agree that they are, and what z is told of them."""

import json
from pathlib import Path

import numpy as np
import pytest
import torch
from torch import Tensor

from nerf_rl.cameras.geometry import intrinsics_from_fovy, look_from
from nerf_rl.errors import MissingFileError
from nerf_rl.pretrain.config import EncoderConfig
from nerf_rl.pretrain.model.encoder import Encoder
from nerf_rl.pretrain.model.encoder_file import DESCRIPTION
from nerf_rl.pretrain.model.encoder_rig import EncoderRig
from nerf_rl.pretrain.model.landmarks import Landmarks, picture_middles, triangulate

LOOKAT = np.array([0.0, 0.6, 0.1])
POSITIONS = ([1.2, 0.3, 0.8], [-1.1, 0.2, 0.9], [0.1, 0.5, 1.6])


def make_rig(height: int = 32, width: int = 48) -> EncoderRig:
    intrinsics = np.stack([intrinsics_from_fovy(45.0, height, width)] * 3)
    poses = np.stack([look_from(np.array(position), LOOKAT) for position in POSITIONS])
    return EncoderRig(("a", "b", "c"), intrinsics, poses, height, width)


def projections(rig: EncoderRig) -> Tensor:
    """Return matrices [1, V, 3, 4] to parts of a picture."""
    size = torch.tensor([rig.width, rig.height, 1.0])
    return torch.from_numpy(rig.projections).float()[None] / size[:, None]


def seen_at(places: Tensor, matrices: Tensor) -> Tensor:
    """Return where views see places [A, 3], in parts of a picture [1, V, A, 2]."""
    seen = torch.einsum("bvij,aj->bvai", matrices, torch.cat([places, torch.ones(len(places), 1)], dim=1))
    return seen[..., :2] / seen[..., 2:]


def test_places_are_where_all_views_see_them():
    matrices, places = projections(make_rig()), torch.tensor([[0.2, 0.5, 0.0], [-0.3, 0.8, 0.3]])
    usual, spread = torch.tensor([[0.0, 0.6, 0.1], [0.0, 0.7, 0.2]]), torch.tensor([0.2, 0.1])
    found = triangulate(seen_at(places, matrices), torch.ones(1, 3, 2), matrices, usual, spread)
    np.testing.assert_allclose(usual + spread[:, None] * found[0], places, atol=1e-3)


@pytest.mark.parametrize("metres", [1.0, 1000.0])
def test_the_unit_of_length_does_not_matter(metres: float):
    matrices, places = projections(make_rig()), torch.tensor([[0.2, 0.5, 0.0]])
    usual, spread, sure = torch.tensor([[0.0, 0.6, 0.1]]), torch.tensor([0.2]), torch.full((1, 3, 1), 0.01)
    found = triangulate(seen_at(places, matrices), sure, matrices, usual, spread)
    scaled = matrices.clone()
    scaled[..., 3] *= metres
    other = triangulate(seen_at(places * metres, scaled), sure, scaled, usual * metres, spread * metres)
    torch.testing.assert_close(other, found, atol=1e-3, rtol=1e-3)


def test_a_view_that_is_sure_counts_more_than_one_that_guesses():
    matrices, places = projections(make_rig()), torch.tensor([[0.2, 0.5, 0.0]])
    usual, spread = torch.tensor([[0.0, 0.6, 0.1]]), torch.tensor([0.2])
    middles = seen_at(places, matrices)
    middles[0, 2] = 0.9
    sure = triangulate(middles, torch.tensor([[[1.0], [1.0], [0.001]]]), matrices, usual, spread)
    misled = triangulate(middles, torch.ones(1, 3, 1), matrices, usual, spread)
    error, worse = ((usual + 0.2 * found[0] - places).norm().item() for found in (sure, misled))
    assert error < 0.002 < 0.05 < worse


def test_what_no_view_shows_is_where_it_usually_is():
    matrices = projections(make_rig())
    usual, spread = torch.tensor([[0.0, 0.6, 0.1]]), torch.tensor([0.2])
    middles, confidence = picture_middles(torch.full((3, 1, 8, 12), 1e-4))
    assert confidence.max() <= 0.001
    found = triangulate(middles.reshape(1, 3, 1, 2), torch.zeros(1, 3, 1), matrices, usual, spread)
    torch.testing.assert_close(found, torch.zeros(1, 1, 3))


def test_the_middle_of_a_mask_is_in_parts_of_width_and_height():
    masks = torch.zeros(1, 2, 8, 12)
    masks[0, 0, 2, 9] = 1.0
    masks[0, 1, 4:6, 2:4] = 0.9
    masks[0, 1] += 0.01  # a little everywhere
    middles, confidence = picture_middles(masks)
    np.testing.assert_allclose(middles[0], [[9.5 / 12, 2.5 / 8], [3 / 12, 5 / 8]], atol=2e-3)
    assert confidence.tolist() == [[1.0, 1.0]]


@pytest.mark.parametrize(("height", "width"), [(32, 48), (35, 50)])
def test_a_drawn_thing_is_found_where_it_is(height: int, width: int):
    """Training on where a thing is in one half of the table finds it in the other half."""
    torch.manual_seed(0)
    rig = make_rig(height, width)
    encoder = Encoder(EncoderConfig(latent=8, channels=[16, 16], hidden=16), rig, landmarks=1)
    assert encoder.landmarks is not None
    encoder.landmarks.place(torch.tensor([[0.0, 0.6, 0.1]]), torch.tensor([0.2]))
    matrices = torch.from_numpy(rig.projections).float()[None]
    optimiser = torch.optim.Adam(encoder.landmarks.parameters(), lr=1e-2)
    optimiser.add_param_group({"params": list(encoder.convolutions.parameters())})
    generator = torch.Generator().manual_seed(0)
    for _ in range(80):
        images, shares, _ = drawn(rig, 16, generator, -0.25, 0.0)
        found = encoder.read(images, matrices.expand(16, -1, -1, -1)).landmarks
        assert found is not None
        loss = -(shares.flatten(0, 1) * found.logits.log_softmax(1)).sum(1).mean()
        optimiser.zero_grad()
        loss.backward()
        optimiser.step()
    images, _, places = drawn(rig, 32, generator, 0.0, 0.25)
    with torch.no_grad():
        found = encoder.read(images, matrices.expand(32, -1, -1, -1)).landmarks
    assert found is not None
    error = (torch.tensor([0.0, 0.6, 0.1]) + 0.2 * found.places[:, 0] - places).norm(dim=1)
    assert error.median() < 0.04, error


def drawn(rig: EncoderRig, count: int, generator: torch.Generator, low: float, high: float) -> tuple:
    """Return pictures of a red square between two x, the shares of their cells, and where it is."""
    places = torch.rand(count, 3, generator=generator) * torch.tensor([high - low, 0.3, 0.2])
    places += torch.tensor([low, 0.45, 0.0])
    matrices = torch.from_numpy(rig.projections).float()
    homogeneous = torch.einsum("vij,bj->bvi", matrices, torch.cat([places, torch.ones(count, 1)], dim=1))
    middles = homogeneous[..., :2] / homogeneous[..., 2:]
    rows, columns = torch.arange(rig.height) + 0.5, torch.arange(rig.width) + 0.5
    near = (columns - middles[..., :1]).abs()[:, :, None, :] < 3
    mask = near & ((rows - middles[..., 1:]).abs()[:, :, :, None] < 3)
    images = torch.full((count, 3, rig.height, rig.width, 3), 90, dtype=torch.uint8)
    images[mask] = torch.tensor([220, 30, 30], dtype=torch.uint8)
    share = torch.nn.functional.avg_pool2d(mask.float(), 4)
    return images, torch.stack([1 - share, 20 * share], dim=2), places


def test_z_is_told_of_landmarks_and_a_file_keeps_them(tmp_path: Path):
    torch.manual_seed(0)
    rig = make_rig()
    encoder = Encoder(EncoderConfig(latent=6, channels=[8, 12], hidden=16), rig, landmarks=2).eval()
    encoder.scene = "metaworld/drawer-open-v3"
    assert encoder.landmarks is not None
    encoder.landmarks.place(torch.tensor([[0.0, 0.6, 0.1], [0.1, 0.7, 0.0]]), torch.tensor([0.2, 0.05]))
    images = torch.randint(0, 255, (4, 3, 32, 48, 3), dtype=torch.uint8)
    z = encoder.encode(images)
    encoder.save(tmp_path, {})
    loaded = Encoder.load(tmp_path)
    torch.testing.assert_close(loaded.encode(images), z, atol=0, rtol=0)
    assert loaded.landmarks is not None and loaded.landmarks.spread.tolist() == pytest.approx([0.2, 0.05])
    blind = Encoder.load(tmp_path)
    assert blind.landmarks is not None
    blind.landmarks.to_latent.weight.zero_()
    assert (blind.encode(images) - z).abs().max() > 1e-3
    fresh = loaded.untrained(seed=1)
    assert fresh.landmarks is not None and fresh.landmarks.spread.tolist() == pytest.approx([0.2, 0.05])


@pytest.mark.parametrize("landmarks", [-1, 256, "2", True])
def test_a_number_of_landmarks_that_cannot_be_is_told(tmp_path: Path, landmarks: object):
    encoder = Encoder(EncoderConfig(latent=6, channels=[8], hidden=16), make_rig(), landmarks=2)
    encoder.scene = "metaworld/drawer-open-v3"
    encoder.save(tmp_path, {"landmarks": landmarks})
    with pytest.raises(MissingFileError, match=r"landmarks is .* instead of"):
        Encoder.load(tmp_path)


def test_an_encoder_of_before_looks_for_none(tmp_path: Path):
    """Its description names neither landmarks nor whether the recipe wants them."""
    encoder = Encoder(EncoderConfig(latent=6, channels=[8], hidden=16), make_rig()).eval()
    encoder.scene = "metaworld/drawer-open-v3"
    encoder.save(tmp_path, {})
    description = json.loads((tmp_path / DESCRIPTION).read_text())
    del description["landmarks"], description["architecture"]["landmarks"]
    (tmp_path / DESCRIPTION).write_text(json.dumps(description | {"format": 2}))
    images = torch.randint(0, 255, (4, 3, 32, 48, 3), dtype=torch.uint8)
    torch.testing.assert_close(Encoder.load(tmp_path).encode(images), encoder.encode(images), atol=0, rtol=0)


def test_there_are_none_without_classes_and_where_the_recipe_wants_none():
    config = EncoderConfig(latent=6, channels=[8], hidden=16)
    assert Encoder(config, make_rig()).landmarks is None
    config.landmarks = False
    assert Encoder(config, make_rig(), landmarks=3).landmarks is None
    assert isinstance(Encoder(EncoderConfig(latent=6, channels=[8]), make_rig(), landmarks=1).landmarks, Landmarks)
