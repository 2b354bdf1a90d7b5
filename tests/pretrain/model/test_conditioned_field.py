"""The field with its latent folded in: the same numbers as the field's own."""

import pytest
import torch

from nerf_rl.pretrain.config import FieldConfig
from nerf_rl.pretrain.model.conditioned_field import ConditionedField
from nerf_rl.pretrain.model.field import FieldBounds, RadianceField


@pytest.mark.parametrize("anchors", [0, 3])
@pytest.mark.parametrize("free_frames", [0, 2])
def test_folding_changes_no_density_and_no_feature(anchors: int, free_frames: int) -> None:
    torch.manual_seed(0)
    config = FieldConfig(width=12, layers=3, frequencies=5, free_frames=free_frames, plane_size=8, plane_features=2)
    bounds = FieldBounds(0.2, 2.0, (0.1, 0.5, 0.2), 0.4)
    field = RadianceField(config, bounds, 6, 4, 0, anchors).requires_grad_(False)
    field.set_coarse_to_fine(0.6)
    latent = torch.randn(6)
    points = torch.tensor(bounds.centre) + 2.0 * torch.randn(500, 3)
    density, features = ConditionedField(field, latent)(points)
    true_density, true_features = field(points[None], latent[None])
    torch.testing.assert_close(density, true_density[0], rtol=1e-4, atol=1e-5)
    torch.testing.assert_close(features, true_features[0], rtol=1e-4, atol=1e-4)


def test_outside_of_the_box_of_all_that_is_seen_there_is_nothing() -> None:
    torch.manual_seed(0)
    config = FieldConfig(width=12, layers=3, frequencies=5, free_frames=0, plane_size=8, plane_features=2)
    bounds = FieldBounds(0.2, 2.0, (0.0, 0.0, 0.0), 1.0, low=(-1.0, -0.5, 0.0), high=(1.0, 1.0, 0.2))
    field = RadianceField(config, bounds, 6, 4, 0).requires_grad_(False)
    latent, points = torch.randn(6), 2.0 * torch.rand(500, 3) - 1.0
    inside = (points[:, 1] > -0.5) & (points[:, 2] > 0.0) & (points[:, 2] < 0.2)
    assert 20 < int(inside.sum()) < 100
    density, features = ConditionedField(field, latent)(points)
    true_density, true_features = field(points[None], latent[None])
    torch.testing.assert_close(density, true_density[0] * inside, rtol=1e-4, atol=1e-5)
    torch.testing.assert_close(features, true_features[0], rtol=1e-4, atol=1e-4)
