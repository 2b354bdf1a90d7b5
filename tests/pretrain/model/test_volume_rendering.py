"""Volume rendering: each function against a loop, an analytic solution or its distribution."""

import math

import numpy as np
import pytest
import torch

from nerf_rl.pretrain.model.volume_rendering import (
    composite,
    even_samples,
    free_space_samples,
    importance_samples,
    median_depth,
    rendering_weights,
    sample_spacings,
    stratified_samples,
    surface_samples,
    widened_weights,
)

CPU = torch.device("cpu")


def random_rays(samples: int) -> tuple[torch.Tensor, torch.Tensor]:
    """Return densities and spacings of a few rays, the last spacing without end."""
    generator = torch.Generator().manual_seed(0)
    density = 20 * torch.rand((2, 3, samples), generator=generator, dtype=torch.float64)
    spacings = 0.1 * torch.rand((2, 3, samples), generator=generator, dtype=torch.float64)
    spacings[..., -1] = 1e10
    return density, spacings


def test_weights_are_those_of_a_loop_along_each_ray():
    density, spacings = random_rays(7)
    weights = rendering_weights(density, spacings)
    for ray in np.ndindex(2, 3):
        transmittance = 1.0
        for sample in range(7):
            opacity = 1.0 - math.exp(-float(density[ray][sample] * spacings[ray][sample]))
            assert float(weights[ray][sample]) == pytest.approx(transmittance * opacity, abs=1e-12)
            transmittance *= 1.0 - opacity


def test_what_passes_a_homogeneous_slab_falls_off_exponentially():
    depths = torch.linspace(0.5, 2.5, 401, dtype=torch.float64)
    direction = torch.tensor([0.3, -0.4, 1.0], dtype=torch.float64)
    density = torch.where((depths >= 1.0) & (depths < 1.6), 3.0, 0.0)
    density[-1] = 1.0
    weights = rendering_weights(density, sample_spacings(depths, direction))
    thickness = 0.6 * math.sqrt(0.3**2 + 0.4**2 + 1.0)
    assert float(weights[-1]) == pytest.approx(math.exp(-3.0 * thickness), rel=1e-6)
    front_half = weights[depths < 1.3].sum()
    assert float(front_half) == pytest.approx(1.0 - math.exp(-3.0 * thickness / 2), rel=1e-6)


def test_weights_sum_to_one_whenever_the_backdrop_has_any_density():
    density, spacings = random_rays(9)
    torch.testing.assert_close(rendering_weights(density, spacings).sum(-1), torch.ones(2, 3, dtype=torch.float64))
    density[..., :-1] = 0.0
    weights = rendering_weights(density, spacings)
    torch.testing.assert_close(weights[..., -1], torch.ones(2, 3, dtype=torch.float64))


def test_the_endless_backdrop_does_not_round_away_the_samples_before_it():
    spacings = torch.full((5,), 0.01)
    spacings[-1] = 1e10
    density = torch.full((5,), 2.0, requires_grad=True)
    weights = rendering_weights(density, spacings)
    expected = [math.exp(-0.02 * i) * (1 - math.exp(-0.02)) for i in range(4)] + [math.exp(-0.08)]
    torch.testing.assert_close(weights.detach(), torch.tensor(expected))
    (gradient,) = torch.autograd.grad(weights[-1], density)
    torch.testing.assert_close(gradient[:4], torch.full((4,), -0.01 * math.exp(-0.08)))


def test_spacings_are_distances_along_the_ray():
    depths = torch.tensor([[0.5, 0.7, 1.2]])
    origin, direction = torch.tensor([[0.1, 0.2, 0.3]]), torch.tensor([[1.0, -2.0, 1.0]])
    points = origin[:, None] + depths[..., None] * direction[:, None]
    spacings = sample_spacings(depths, direction)
    torch.testing.assert_close(spacings[:, :-1], (points[:, 1:] - points[:, :-1]).norm(dim=-1))
    assert float(spacings[0, -1]) >= 1e9


def test_a_ray_that_leaves_the_box_has_no_length_beyond():
    depths = torch.tensor([[0.5, 0.7, 1.2, 9.0], [0.5, 0.7, 1.2, 9.0], [0.5, 0.7, 1.2, 9.0]])
    directions, leave = torch.tensor([[0.0, 0.0, 1.0]]).expand(3, 3), torch.tensor([1.5, 0.9, 9.0])
    spacings = sample_spacings(depths, directions, leave)
    expected = torch.tensor([[0.2, 0.5, 0.3], [0.2, 0.2, 0.0], [0.2, 0.5, 7.8]])
    torch.testing.assert_close(spacings[:, :-1], expected)
    assert (spacings[:, -1] >= 1e9).all()
    weights = torch.tensor([[0.0, 0.0, 0.8, 0.2], [0.0, 0.8, 0.0, 0.2], [0.0, 0.0, 0.8, 0.2]])
    assert (median_depth(weights, depths, leave) <= leave).all()


def test_stratified_samples_have_one_in_each_bin():
    generator = torch.Generator().manual_seed(1)
    samples = stratified_samples(0.5, 2.5, torch.rand(50, 4, 8, generator=generator))
    bins = ((samples - 0.5) / 0.25).floor()
    assert (bins == torch.arange(8.0)).all()
    within = (samples - 0.5) / 0.25 - bins
    assert float(within.mean()) == pytest.approx(0.5, abs=0.03) and float(within.std()) == pytest.approx(
        0.289, abs=0.02
    )


def test_even_samples_are_the_centres_of_bins():
    samples = even_samples(1.0, 3.0, (2,), 4, CPU)
    torch.testing.assert_close(samples, torch.tensor([1.25, 1.75, 2.25, 2.75]).expand(2, 4))


def test_surface_samples_are_normal_around_the_surface_and_stay_within_bounds():
    generator = torch.Generator().manual_seed(2)
    samples = surface_samples(torch.tensor([1.0, 0.5, 2.0]), 0.02, 0.5, 2.0, torch.randn(3, 4000, generator=generator))
    assert float(samples[0].mean()) == pytest.approx(1.0, abs=0.002)
    assert float(samples[0].std()) == pytest.approx(0.02, abs=0.002)
    assert float(samples.min()) == 0.5 and float(samples.max()) == 2.0


def test_free_space_samples_lie_before_the_surface_and_are_denser_towards_it():
    generator = torch.Generator().manual_seed(5)
    samples = free_space_samples(torch.tensor([1.0, 0.6]), 0.4, 0.5, torch.rand(2, 4000, generator=generator))
    assert float(samples[0].min()) == pytest.approx(0.6, abs=1e-3) and float(samples[0].max()) <= 1.0
    for quantile in (0.25, 0.5, 0.75):  # of depth - reach u^2, with u uniform
        expected = 1.0 - 0.4 * (1 - quantile) ** 2
        assert float(samples[0].quantile(quantile)) == pytest.approx(expected, abs=2e-3)
    assert float(samples[1].min()) == 0.5 and float(samples[1].max()) <= 0.6 + 1e-6


def test_importance_samples_reproduce_the_distribution_of_the_weights():
    depths = torch.tensor([1.0, 1.4, 1.5, 2.0, 3.0])
    weights = torch.tensor([0.1, 0.0, 0.5, 0.3, 0.1])
    samples = importance_samples(depths, weights, 10_000)
    edges = [1.0, 1.2, 1.45, 1.75, 2.5, 3.0]  # midpoints of samples
    counts, _ = np.histogram(samples.numpy(), edges)
    np.testing.assert_allclose(counts / 10_000, weights.numpy(), atol=2e-3)
    inside = samples[(samples > 1.75) & (samples < 2.5)]
    assert float(inside.mean()) == pytest.approx(2.125, abs=0.01)  # evenly between midpoints


def test_importance_samples_of_many_rays_are_those_of_each_ray():
    generator = torch.Generator().manual_seed(3)
    depths = torch.rand((3, 2, 6), generator=generator).sort(-1).values
    weights = torch.rand((3, 2, 6), generator=generator)
    samples = importance_samples(depths, weights, 5)
    for ray in np.ndindex(3, 2):
        torch.testing.assert_close(samples[ray], importance_samples(depths[ray], weights[ray], 5))


def test_importance_samples_of_an_empty_ray_are_spread_over_it():
    depths = torch.linspace(1.0, 2.0, 11)
    samples = importance_samples(depths, torch.zeros(11), 100)
    assert torch.isfinite(samples).all()
    assert float(samples.min()) < 1.05 and float(samples.max()) > 1.95
    assert float(samples.diff().max()) < 0.03


def test_widened_weights_are_means_of_the_maxima_with_either_neighbour():
    weights = torch.rand((2, 3, 7), generator=torch.Generator().manual_seed(0))
    widened = widened_weights(weights)
    for ray in np.ndindex(2, 3):
        own = weights[ray].tolist()
        for sample in range(7):
            before, after = own[max(sample - 1, 0)], own[min(sample + 1, 6)]
            expected = 0.5 * max(before, own[sample]) + 0.5 * max(own[sample], after)
            assert float(widened[ray][sample]) == pytest.approx(expected)


def test_compositing_is_the_weighted_sum():
    generator = torch.Generator().manual_seed(4)
    weights, values = torch.rand((2, 3, 5), generator=generator), torch.rand((2, 3, 5, 4), generator=generator)
    expected = sum(weights[..., i, None] * values[..., i, :] for i in range(5))
    torch.testing.assert_close(composite(weights, values), expected)


def test_the_median_depth_is_where_half_of_the_light_is_gone():
    depths = torch.linspace(0.5, 2.5, 11, dtype=torch.float64)
    for density in (0.5, 2.0, 40.0):
        along = torch.full_like(depths, density)
        median = median_depth(rendering_weights(along, sample_spacings(depths, torch.eye(3)[2].double())), depths)
        assert float(median) == pytest.approx(min(0.5 + math.log(2.0) / density, 2.5), abs=1e-9)


def test_the_median_depth_of_many_rays_is_found_between_the_samples_of_each():
    density, spacings = random_rays(9)
    depths = torch.cat([torch.zeros(2, 3, 1, dtype=torch.float64), spacings[..., :-1].cumsum(-1)], dim=-1)
    medians = median_depth(rendering_weights(density, spacings), depths)
    for ray in np.ndindex(2, 3):
        optical = 0.0
        for sample in range(8):
            length = float(depths[ray][sample + 1] - depths[ray][sample])
            added = float(density[ray][sample]) * length
            if optical + added >= math.log(2.0):
                expected = float(depths[ray][sample]) + length * (math.log(2.0) - optical) / added
                break
            optical += added
        else:
            expected = float(depths[ray][-1])
        assert float(medians[ray]) == pytest.approx(expected, abs=1e-9)


def test_a_ray_that_may_meet_either_of_two_surfaces_has_a_depth_on_one_of_them():
    depths = torch.tensor([0.8, 1.0, 1.2, 1.9, 2.0, 5.0])
    for near, expected in ((0.4, 2.0), (0.6, 1.0)):
        weights = torch.tensor([0.0, near, 0.0, 0.0, 1.0 - near, 0.0])
        assert float(median_depth(weights, depths)) == pytest.approx(expected, abs=0.2)
        assert float((weights * depths).sum()) == pytest.approx(2.0 - near)  # in the empty space between them


def test_the_median_depth_of_opaque_and_of_empty_rays_is_finite_in_single_precision():
    depths = torch.tensor([0.5, 1.0, 2.0])
    weights = torch.eye(3)
    assert median_depth(weights, depths.expand(3, -1)).tolist() == [0.5, 1.0, 2.0]
    short = torch.tensor([[0.5, 0.0, 0.4999999], [0.0, 0.0, 0.9999999]])
    assert median_depth(short, depths.expand(2, -1)).isfinite().all()
