"""Rendering of a field that is known: a sphere in empty space, whose silhouette and depth are analytic."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from torch import Tensor, nn

from nerf_rl.cameras import geometry as cameras
from nerf_rl.errors import UserError
from nerf_rl.pretrain.config import SamplingConfig
from nerf_rl.pretrain.model import ray_rendering as rendering
from nerf_rl.pretrain.model.field import FieldBounds, RadianceField

CENTRE, RADIUS = (0.1, -0.15, 0.05), 0.25  # off the optical axis, so that a flipped image would show
SIZE = 32
SAMPLING = SamplingConfig(training_stratified=4, training_surface=16, rendering_stratified=48, rendering_importance=32)


class SphereField(RadianceField):
    """Dense inside a sphere of radius z[0], almost empty elsewhere; features are the position and what is there."""

    def __init__(self) -> None:
        nn.Module.__init__(self)
        self.bounds = FieldBounds(0.3, 2.0, CENTRE, 1.0)
        self.corners = self.bounds.corners()

    def forward(self, points: Tensor, latent: Tensor) -> tuple[Tensor, Tensor]:
        inside = (points - torch.tensor(CENTRE)).norm(dim=-1) < latent[:, :1]
        density = torch.where(inside, 2000.0, 1e-6)
        there = torch.stack([~inside, inside], dim=-1).to(points.dtype)
        return density, torch.cat([points, there], dim=-1)

    def read(self, features: Tensor) -> dict[str, Tensor]:
        return {"rgb": features[..., 4:].expand(*features.shape[:-1], 3), "semantic": features[..., 3:]}


def view() -> tuple[np.ndarray, np.ndarray]:
    """Return the intrinsics and pose of two cameras."""
    poses = [
        cameras.look_at(np.zeros(3), 1.0, azimuth, elevation) for azimuth, elevation in ((30.0, -20.0), (140.0, -50.0))
    ]
    return np.stack([cameras.intrinsics_from_fovy(50.0, SIZE, SIZE)] * 2), np.stack(poses)


def analytic_depth(intrinsics: np.ndarray, poses: np.ndarray) -> np.ndarray:
    """Return the planar depth of the sphere's surface [V, H, W], infinite beside it."""
    pixels = np.broadcast_to(cameras.pixel_centres(SIZE, SIZE), (len(poses), SIZE * SIZE, 2))
    directions = cameras.pixel_directions(intrinsics, poses, pixels)
    offset = cameras.camera_position(poses)[:, None] - np.array(CENTRE)
    a, b = (directions**2).sum(-1), (directions * offset).sum(-1)
    discriminant = b**2 - a * ((offset**2).sum(-1) - RADIUS**2)
    depth = (-b - np.sqrt(np.maximum(discriminant, 0))) / a
    return np.where(discriminant > 0, depth, np.inf).reshape(-1, SIZE, SIZE)


def render() -> rendering.RenderedImages:
    intrinsics, poses = view()
    return rendering.render_images(SphereField(), torch.tensor([RADIUS]), intrinsics, poses, SIZE, SIZE, SAMPLING)


def test_without_known_depth_the_silhouette_and_depth_are_the_analytic_ones():
    expected, images = analytic_depth(*view()), render()
    truth, seen = np.isfinite(expected), images.semantic == 1
    assert truth.sum() > 200
    assert (truth & seen).sum() / (truth | seen).sum() > 0.97
    both = truth & seen
    assert np.median(np.abs(images.depth - expected)[both]) < 0.005
    assert np.quantile(np.abs(images.depth - expected)[both], 0.95) < 0.02
    np.testing.assert_allclose(images.rgb[~truth & ~seen], 0.0, atol=1e-3)
    assert images.rgb[both].mean() > 0.99


def test_beside_the_sphere_the_depth_is_the_backdrops():
    expected, images = analytic_depth(*view()), render()
    outside = ~np.isfinite(expected) & (images.semantic == 0)
    assert outside.sum() > 500
    np.testing.assert_allclose(images.depth[outside], 2.0, atol=1e-3)


def test_images_do_not_depend_on_the_size_of_chunks(monkeypatch: pytest.MonkeyPatch):
    whole = render()
    monkeypatch.setattr(rendering, "_POINTS_PER_CHUNK", 5000)
    parts = render()
    np.testing.assert_allclose(parts.depth, whole.depth, atol=1e-6)
    np.testing.assert_allclose(parts.rgb, whole.rgb, atol=1e-6)
    np.testing.assert_array_equal(parts.semantic, whole.semantic)


def rays() -> tuple[Tensor, Tensor, Tensor]:
    """Return origins, directions and analytic depth (the backdrop's where nothing is hit) of two scenes' rays."""
    intrinsics, poses = view()
    pixels = np.broadcast_to(cameras.pixel_centres(SIZE, SIZE), (2, SIZE * SIZE, 2))
    directions = cameras.pixel_directions(intrinsics, poses, pixels)
    origins = np.broadcast_to(cameras.camera_position(poses)[:, None], directions.shape)
    depth = np.minimum(analytic_depth(intrinsics, poses).reshape(2, -1), 2.0)
    tensors = [torch.from_numpy(np.array(array, np.float32)) for array in (origins, directions, depth)]
    return tensors[0], tensors[1], tensors[2]


def noise(seed: int) -> rendering.SampleNoise:
    generator = torch.Generator().manual_seed(seed)
    return rendering.SampleNoise.draw(SAMPLING, 2, SIZE * SIZE, generator, torch.device("cpu"))


def test_with_known_depth_few_samples_find_the_same_surface():
    origins, directions, depth = rays()
    latent = torch.full((2, 1), RADIUS)
    rendered = rendering.render_depth_guided(SphereField(), latent, origins, directions, depth, SAMPLING, noise(0))
    assert rendered.depths.shape[-1] == 4 + SAMPLING.training_free_space + 16 + 1
    assert (rendered.depths.diff(dim=-1) >= 0).all() and (rendered.depths[..., -1] == 2.0).all()
    torch.testing.assert_close(rendered.weights.sum(-1), torch.ones_like(depth))
    assert float((rendered.depth - depth).abs().median()) < 0.01
    hit = depth < 2.0
    assert float((rendered.values["semantic"].argmax(-1) == hit).float().mean()) > 0.98


def test_in_training_too_the_surface_is_found_without_known_depth():
    """Importance samples lie where the even ones found density, whatever depth says."""
    origins, directions, depth = rays()
    latent = torch.full((2, 1), RADIUS)
    sampling = SamplingConfig(
        training_stratified=48,
        training_importance=32,
        training_free_space=0,
        training_surface=0,
        rendering_stratified=48,
    )
    generator = torch.Generator().manual_seed(0)
    drawn = rendering.SampleNoise.draw(sampling, 2, SIZE * SIZE, generator, torch.device("cpu"))
    told = torch.rand(depth.shape, generator=generator)
    rendered = rendering.render_depth_guided(SphereField(), latent, origins, directions, told, sampling, drawn)
    assert rendered.depths.shape[-1] == 48 + 32 + 1 and (rendered.depths.diff(dim=-1) >= 0).all()
    hit = depth < 2.0
    near = (rendered.depths - depth[..., None]).abs() < 0.05
    assert float(near[hit].sum(-1).float().mean()) > 8
    assert float((rendered.depth - depth)[hit].abs().median()) < 0.02


def test_importance_samples_in_training_need_even_ones():
    with pytest.raises(UserError, match="training_importance needs at least 2 training_stratified"):
        SamplingConfig(training_stratified=1, training_importance=8)


def test_a_surface_anywhere_between_two_even_samples_is_closed_in_on_from_both_sides():
    origins, directions, depth = rays()
    sampling = SamplingConfig(rendering_stratified=12, rendering_importance=16)
    rendered = rendering.render_without_depth(SphereField(), torch.full((2, 1), RADIUS), origins, directions, sampling)
    spacing = (2.0 - 0.3) / 12
    behind = (rendered.depths > depth[..., None]).int().argmax(-1, keepdim=True)  # the first sample behind the surface
    found = (depth < 2.0) & (rendered.weights[..., -1] < 0.5)  # thinner than the spacing at its rim, it may be missed
    gap = rendered.depths.gather(-1, behind) - rendered.depths.gather(-1, (behind - 1).clamp(min=0))
    assert int(found.sum()) > 200
    assert float((gap[..., 0][found] < spacing / 3).float().mean()) > 0.95


def test_samples_are_within_the_box_of_what_is_seen():
    """A few even ones then find what many do all along the rays."""
    origins, directions, depth = rays()
    latent, field = torch.full((2, 1), RADIUS), SphereField()
    low, high = (tuple(c + sign * 1.2 * RADIUS for c in CENTRE) for sign in (-1.0, 1.0))
    field.bounds = replace(field.bounds, low=low, high=high)
    field.corners = field.bounds.corners()
    near, far = field.ray_limits(origins, directions)
    assert 0.2 < float((near < far).float().mean()) < 0.8
    sampling = SamplingConfig(training_stratified=4, rendering_stratified=12, rendering_importance=16)
    free = rendering.render_depth_guided(field, latent, origins, directions, depth, SAMPLING, noise(0))
    found = rendering.render_without_depth(field, latent, origins, directions, sampling)
    for rendered in (free, found):
        samples = rendered.depths[..., :-1]
        assert (samples >= near[..., None]).all() and (samples <= far[..., None]).all()
        assert (rendered.depths[..., -1] == 2.0).all()
        assert (rendered.weights[..., -1][near == 2.0] == 1.0).all()  # rays that miss the box see the backdrop alone
        assert float(((rendered.values["semantic"].argmax(-1) == 1) == (depth < 2.0)).float().mean()) > 0.98
    hit = (depth < 2.0) & (found.values["semantic"].argmax(-1) == 1)
    assert float((found.depth - depth)[hit].abs().median()) < 0.005


class FogField(SphereField):
    """Thin fog everywhere in a box around the sphere's place, of which nothing is outside of the box."""

    density = 1.5

    def __init__(self, far: float) -> None:
        super().__init__()
        low, high = (tuple(c + sign * 1.2 * RADIUS for c in CENTRE) for sign in (-1.0, 1.0))
        self.bounds = FieldBounds(0.3, far, CENTRE, 1.0, low, high)
        self.corners = self.bounds.corners()

    def forward(self, points: Tensor, latent: Tensor) -> tuple[Tensor, Tensor]:
        there = torch.ones(*points.shape[:-1], 2)
        return torch.full(points.shape[:-1], self.density), torch.cat([points, there], dim=-1)


@pytest.mark.parametrize("far", [2.0, 50.0])
@pytest.mark.parametrize("guided", [True, False])
def test_fog_in_a_box_absorbs_what_its_way_through_the_box_says_however_far_the_backdrop_is(far: float, guided: bool):
    """The last sample in the box once stood for the way on to the backdrop as well."""
    origins, directions, _ = rays()
    field, latent = FogField(far), torch.full((2, 1), RADIUS)
    near, leave = field.ray_limits(origins, directions)
    if guided:
        missed = torch.full_like(near, far)
        rendered = rendering.render_depth_guided(field, latent, origins, directions, missed, SAMPLING, noise(0))
    else:
        rendered = rendering.render_without_depth(field, latent, origins, directions, SAMPLING)
    way = (leave - near) * directions.norm(dim=-1)
    absorbed = 1.0 - rendered.weights[..., -1]
    # what comes before the first sample is not looked at: at most one even part of the way
    parts = SAMPLING.training_stratified if guided else SAMPLING.rendering_stratified
    most, least = (1.0 - torch.exp(-field.density * share * way) for share in (1.0, 1.0 - 1.0 / parts))
    assert (absorbed <= most + 1e-5).all() and (absorbed >= least - 1e-5).all()
    assert (rendered.depth[rendered.weights[..., -1] < 0.5] <= leave[rendered.weights[..., -1] < 0.5]).all()


def test_what_two_passes_found_is_what_one_pass_over_all_their_samples_finds():
    origins, directions, _ = rays()
    latent = torch.tensor([[RADIUS], [0.5 * RADIUS]])
    rendered = rendering.render_without_depth(SphereField(), latent, origins, directions, SAMPLING)
    assert (rendered.depths.diff(dim=-1) >= 0).all()
    again = rendering.render_at(SphereField(), latent, origins, directions, rendered.depths, rendered.leave)
    torch.testing.assert_close(rendered.weights, again.weights)
    assert rendered.values["semantic"].argmax(-1).sum() > 100
    for name, value in again.values.items():
        torch.testing.assert_close(rendered.values[name], value)


def test_each_scene_is_rendered_from_its_own_latent():
    origins, directions, _ = rays()
    latent = torch.tensor([[RADIUS], [0.0]])
    rendered = rendering.render_without_depth(SphereField(), latent, origins, directions, SAMPLING)
    found = rendered.values["semantic"].argmax(-1).sum(-1)
    assert int(found[0]) > 100 and int(found[1]) == 0


def test_samples_that_are_drawn_depend_on_the_generator_alone_and_divide_by_scenes():
    origins, directions, depth = rays()
    latent = torch.full((2, 1), RADIUS)

    def drawn(seed: int, share: slice = slice(None)) -> Tensor:
        torch.rand(3)
        part, own = (origins[share], directions[share], depth[share]), noise(seed).of_scenes(share)
        return rendering.render_depth_guided(SphereField(), latent[share], *part, SAMPLING, own).depths

    assert torch.equal(drawn(0), drawn(0)) and not torch.equal(drawn(0), drawn(1))
    assert torch.equal(torch.cat([drawn(0, slice(0, 1)), drawn(0, slice(1, 2))]), drawn(0))
