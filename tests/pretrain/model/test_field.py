"""The radiance field: contraction, heads, dependence on z, storage."""

import json
from dataclasses import replace
from pathlib import Path

import pytest
import torch

from nerf_rl.errors import MissingFileError
from nerf_rl.files.tensor_files import read_tensors, write_tensors
from nerf_rl.pretrain.config import FieldConfig
from nerf_rl.pretrain.model.field import FieldBounds, RadianceField, contract
from nerf_rl.pretrain.model.volume_rendering import composite

BOUNDS = FieldBounds(0.4, 2.0, (0.1, 0.6, 0.2), 0.5)


@pytest.fixture
def field() -> RadianceField:
    torch.manual_seed(0)
    config = FieldConfig(width=12, layers=3, frequencies=3, plane_size=6, plane_features=2)
    return RadianceField(config, BOUNDS, latent=5, classes=4, teacher_features=3, anchors=2)


def points_and_latents(scenes: int = 2, points: int = 7) -> tuple[torch.Tensor, torch.Tensor]:
    generator = torch.Generator().manual_seed(1)
    return torch.randn((scenes, points, 3), generator=generator), torch.randn((scenes, 5), generator=generator)


def test_contraction_leaves_the_unit_cube_and_bounds_the_rest():
    generator = torch.Generator().manual_seed(2)
    inside = 2 * torch.rand((100, 3), generator=generator) - 1
    torch.testing.assert_close(contract(inside), inside)
    far = 1e6 * torch.randn((100, 3), generator=generator)
    norms = contract(far).abs().amax(-1)
    assert float(norms.max()) <= 2.0 and float(norms.min()) > 1.99


def test_contraction_keeps_directions_and_order_and_is_continuous_at_the_cube():
    direction = torch.tensor([0.5, -1.0, 0.2])
    scales = torch.linspace(0.1, 50, 500)
    contracted = contract(scales[:, None] * direction)
    torch.testing.assert_close(
        contracted / contracted.norm(dim=-1, keepdim=True), (direction / direction.norm()).expand(500, 3)
    )
    assert (contracted.norm(dim=-1).diff() > 0).all()
    torch.testing.assert_close(contract(1.000001 * direction), contract(0.999999 * direction), atol=1e-5, rtol=0)


@pytest.mark.parametrize("share", [0.3, 1.0])
def test_frames_are_folded_into_what_encoding_a_point_in_each_of_them_gives(field: RadianceField, share: float):
    """The law by its definition: the first layer reads x and x - o of every frame, in sines and cosines of octaves."""
    field.set_coarse_to_fine(share)
    points, latent = points_and_latents()
    x = contract((points - field.centre) / BOUNDS.half_extent)
    origins = (field.origins(latent) - field.centre) / BOUNDS.half_extent
    assert origins.shape == (2, 6, 3)

    def waves(y: torch.Tensor, weights: torch.Tensor) -> list[torch.Tensor]:
        angles = [octave * y for octave in field.octaves]
        return [w * wave(angle) for wave in (torch.sin, torch.cos) for w, angle in zip(weights, angles, strict=True)]

    encoded = [x, *waves(x, torch.ones(3))]
    for frame in range(6):
        y = x - origins[:, None, frame]
        encoded += [y, *waves(y, field.octave_weights)]
    looked_up = field.static_features(x), field.object_planes(x, origins[:, :2])
    hidden = torch.cat([*encoded, *looked_up], dim=-1)
    for i, layer in enumerate(field.layers):
        hidden = layer(hidden)
        if str(i) in field.latent_layers:
            hidden = hidden + field.latent_layers[str(i)](latent)[:, None]
        hidden = hidden.relu()
    torch.testing.assert_close(field(points, latent)[1], hidden, atol=1e-4, rtol=1e-4)


def test_anchored_frames_start_where_they_are_put(field: RadianceField):
    with torch.no_grad():
        field.frame_origins.weight.zero_()
    places = torch.tensor([[0.1, 0.7, 0.05], [0.3, 0.4, 0.2]])
    others = field.origins(torch.zeros(1, 5))[0, 2:]
    field.place_anchors(places, torch.ones(2), torch.ones(2))
    torch.testing.assert_close(field.origins(torch.zeros(1, 5))[0, :2], places)
    torch.testing.assert_close(field.origins(torch.zeros(1, 5))[0, 2:], others)


def test_anchored_frames_move_in_units_of_their_classes_ways(field: RadianceField):
    """So a step of the optimiser moves each by the same share of its way, however short that is."""
    spread, latent = torch.tensor([0.2, 0.004]), torch.randn(64, 5)
    field.place_anchors(torch.zeros(2, 3), spread, torch.ones(2))
    before = field.origins(latent)
    optimiser = torch.optim.Adam(field.frame_origins.parameters(), lr=1e-3)
    field.origins(latent).square().sum().backward()
    field.frame_origins.bias.grad.zero_()
    optimiser.step()
    moved = (field.origins(latent) - before).detach().square().mean((0, 2)).sqrt()
    near, far = moved[:2] / spread
    assert 0.5 < near / far < 2.0
    assert moved[2:].min() > 50 * moved[1]  # of which nobody knows how far they go


def test_a_field_of_before_units_has_its_origins_where_they_were(field: RadianceField, tmp_path: Path):
    field.save(tmp_path)
    tensors = read_tensors(tmp_path / "field.safetensors")
    assert torch.equal(tensors.pop("frame_origins.units"), torch.ones(6))
    write_tensors(tmp_path / "field.safetensors", tensors)
    latent = torch.randn(3, 5)
    assert torch.equal(RadianceField.load(tmp_path).origins(latent), field.origins(latent))


def test_units_are_kept_with_the_field(field: RadianceField, tmp_path: Path):
    field.place_anchors(torch.rand(2, 3), torch.tensor([0.3, 0.01]), torch.tensor([0.2, 0.05]))
    field.save(tmp_path)
    latent = torch.randn(3, 5)
    assert torch.equal(RadianceField.load(tmp_path).origins(latent), field.origins(latent))
    assert torch.equal(RadianceField.load(tmp_path).object_planes.reach, field.object_planes.reach)


def test_a_field_of_before_object_planes_has_none(tmp_path: Path):
    config = FieldConfig(width=12, layers=3, frequencies=3, plane_size=6, object_plane_size=0, plane_features=2)
    field = RadianceField(config, BOUNDS, latent=5, classes=4, teacher_features=3, anchors=2)
    field.save(tmp_path)
    described = json.loads((tmp_path / "field.json").read_text())
    del described["config"]["object_plane_size"]
    described["format"] = 2
    (tmp_path / "field.json").write_text(json.dumps(described))
    loaded = RadianceField.load(tmp_path)
    points, latent = points_and_latents()
    assert loaded.object_planes is None and torch.equal(loaded(points, latent)[1], field(points, latent)[1])


def boxed(low: tuple[float, float, float], high: tuple[float, float, float]) -> RadianceField:
    config = FieldConfig(width=12, layers=3, frequencies=3, plane_size=6, plane_features=2)
    return RadianceField(config, replace(BOUNDS, low=low, high=high), latent=5, classes=4, teacher_features=3)


def test_rays_are_evaluated_between_where_they_enter_the_box_and_where_they_leave_it():
    field = boxed((-1.0, -1.0, 0.0), (1.0, 1.0, 0.5))
    above, inside, below = torch.tensor([[0.0, 0.0, 1.5], [0.0, 0.0, 0.25], [0.0, 0.0, -0.1]])
    down, slanted, level = torch.tensor([[0.0, 0.0, -1.0], [1.2, 0.0, -1.0], [1.0, 0.0, 0.0]])
    expected = [
        (above, down, 1.0, 1.5),
        (above, slanted, 2.0, 2.0),  # it would enter at 1.0 and leave by the side at 1 / 1.2, before that
        (above, level, 2.0, 2.0),
        (inside, level, 0.4, 1.0),  # as near as rays begin
        (inside, 0.25 * level, 0.4, 2.0),  # as far as they go
        (below, -0.1 * down, 1.0, 2.0),
        (below, down, 2.0, 2.0),
    ]
    origins, directions = (torch.stack([row[i] for row in expected]) for i in (0, 1))
    near, far = field.ray_limits(origins[None], directions[None])
    torch.testing.assert_close(near, torch.tensor([[row[2] for row in expected]]))
    torch.testing.assert_close(far, torch.tensor([[row[3] for row in expected]]))


def test_without_a_box_rays_are_evaluated_all_along(field: RadianceField):
    points, _ = points_and_latents()
    directions = torch.randn(points.shape) * torch.tensor([1.0, 0.0, 1.0])
    near, far = field.ray_limits(points, directions)
    assert near.shape == points.shape[:-1] and (near == BOUNDS.near).all() and (far == BOUNDS.far).all()


def test_the_box_is_kept_with_the_field(tmp_path: Path):
    field = boxed((-1.0, -2.0, 0.0), (1.0, 1.0, 0.5))
    field.save(tmp_path)
    assert RadianceField.load(tmp_path).bounds == field.bounds
    described = json.loads((tmp_path / "field.json").read_text())
    for bounds in ({"low": [1.0, 0.0, 0.0]}, {"high": None}, {"low": [0.0, 0.0]}):
        changed = described | {"bounds": described["bounds"] | bounds}
        (tmp_path / "field.json").write_text(json.dumps(changed))
        with pytest.raises(MissingFileError, match=r"it is damaged \(bounds\.low"):
            RadianceField.load(tmp_path)


def test_a_field_of_before_the_box_is_evaluated_all_along(field: RadianceField, tmp_path: Path):
    field.save(tmp_path)
    described = json.loads((tmp_path / "field.json").read_text())
    del described["bounds"]["low"], described["bounds"]["high"]
    (tmp_path / "field.json").write_text(json.dumps(described | {"format": 3}))
    assert RadianceField.load(tmp_path).bounds == BOUNDS


def test_heads_after_compositing_equal_heads_before(field: RadianceField):
    generator = torch.Generator().manual_seed(3)
    weights = torch.rand((2, 6, 9), generator=generator)
    weights = weights / weights.sum(-1, keepdim=True)
    features = torch.randn((2, 6, 9, 12), generator=generator)
    after, before = field.read(composite(weights, features)), field.read(features)
    assert set(after) == {"rgb", "semantic", "feature"}
    for name, values in after.items():
        torch.testing.assert_close(values, composite(weights, before[name]), atol=1e-5, rtol=1e-5)
    assert [after[name].shape[-1] for name in ("rgb", "semantic", "feature")] == [3, 4, 3]


def test_a_field_without_teachers_has_no_feature_head():
    field = RadianceField(FieldConfig(width=8, plane_size=4), BOUNDS, latent=5, classes=2, teacher_features=0)
    assert set(field.read(torch.zeros(3, 8))) == {"rgb", "semantic"}


def test_z_changes_density_and_features_of_its_own_scene_only(field: RadianceField):
    points, latent = points_and_latents()
    density, features = field(points, latent)
    other = latent.clone()
    other[1] += 1.0
    density_then, features_then = field(points, other)
    torch.testing.assert_close(density_then[0], density[0])
    torch.testing.assert_close(features_then[0], features[0])
    assert not torch.isclose(density_then[1], density[1]).all()
    assert not torch.isclose(features_then[1], features[1]).all()


def test_density_is_never_negative_and_gradients_reach_everything(field: RadianceField):
    points, latent = points_and_latents(3, 50)
    density, features = field(points, latent.requires_grad_())
    assert float(density.detach().min()) >= 0
    values = field.read(features)
    (density.sum() + sum((value**2).sum() for value in values.values())).backward()
    for name, parameter in field.named_parameters():
        assert parameter.grad is not None and parameter.grad.abs().sum() > 0, name
    assert latent.grad is not None and (latent.grad.abs().sum(-1) > 0).all()


def test_a_points_value_does_not_depend_on_the_points_beside_it(field: RadianceField):
    points, latent = points_and_latents(2, 8)
    density, features = field(points, latent)
    for i in range(8):
        alone = field(points[:, i : i + 1], latent)
        torch.testing.assert_close(alone[0][:, 0], density[:, i])
        torch.testing.assert_close(alone[1][:, 0], features[:, i])


def test_moving_frames_see_finer_octaves_as_the_field_is_sharpened(field: RadianceField):
    points, latent = points_and_latents()
    sharp = field(points, latent)
    field.set_coarse_to_fine(0.0)
    assert field.octave_weights.tolist() == [1.0, 1.0, 0.0]
    blurred = field(points, latent)
    assert not torch.isclose(blurred[0], sharp[0]).all()
    field.set_coarse_to_fine(0.5)
    torch.testing.assert_close(field.octave_weights, torch.tensor([1.0, 1.0, 0.5]))
    field.set_coarse_to_fine(1.0)
    for now, then in zip(field(points, latent), sharp, strict=True):
        torch.testing.assert_close(now, then, atol=0, rtol=0)


def test_a_blurred_field_still_sees_fine_octaves_where_nothing_moves(field: RadianceField):
    """Only moving frames wait: with their inputs removed, sharpening changes nothing."""
    points, latent = points_and_latents()
    still = 3 + 6 * field.config.frequencies
    moving = still * field.frames
    with torch.no_grad():
        field.layers[0].weight[:, still : still + moving] = 0.0
    sharp = field(points, latent)
    field.set_coarse_to_fine(0.0)
    for blurred, expected in zip(field(points, latent), sharp, strict=True):
        torch.testing.assert_close(blurred, expected, atol=0, rtol=0)


@pytest.mark.parametrize("share", [0.3, 1.0])
def test_a_stored_field_is_the_same_field(field: RadianceField, tmp_path: Path, share: float):
    field.set_coarse_to_fine(share)
    field.save(tmp_path)
    loaded = RadianceField.load(tmp_path)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["field.json", "field.safetensors"]
    assert loaded.bounds == BOUNDS and loaded.config == field.config and not loaded.training
    points, latent = points_and_latents()
    for mine, theirs in zip(field(points, latent), loaded(points, latent), strict=True):
        torch.testing.assert_close(mine, theirs, atol=0, rtol=0)
    mine, theirs = field.read(torch.ones(12)), loaded.read(torch.ones(12))
    for name, value in mine.items():
        torch.testing.assert_close(value, theirs[name], atol=0, rtol=0)


def test_points_that_are_nowhere_are_looked_up_without_harm(field: RadianceField):
    """PyTorch's grid_sample reads and writes outside of its grid there, which ends the process."""
    points = torch.rand(2, 40, 3)
    points[0, :20], points[1, 5:30] = float("nan"), float("inf")
    density, features = field(points, torch.zeros(2, field.sizes["latent"]))
    (density.nan_to_num(0.0).sum() + features.nan_to_num(0.0).sum()).backward()
    assert density[1, :5].isfinite().all() and field.planes.grad is not None
