"""Volume rendering along rays, as pure functions over tensors.

A ray is an origin and a direction of unit planar depth, so sample positions ``t`` are planar depths [m]. Samples are
sorted along the last dimension S; leading dimensions are free. Following Max, "Optical models for direct volume
rendering" (1995), as in NeRF (2020), equation 3:

    weight_i = T_i (1 - exp(-density_i delta_i)),  T_i = exp(-sum_{j<i} density_j delta_j).
"""

import torch
from jaxtyping import Float
from torch import Tensor

Limit = float | Float[Tensor, "*B"]
"""a planar depth [m], of all rays or of each"""


def even_samples(
    near: Limit, far: Limit, shape: tuple[int, ...], count: int, device: torch.device
) -> Float[Tensor, "*B S"]:
    """Return the centres of ``count`` equal bins between near and far [m]."""
    return stratified_samples(near, far, torch.full((*shape, count), 0.5, device=device))


def stratified_samples(near: Limit, far: Limit, offsets: Float[Tensor, "*B S"]) -> Float[Tensor, "*B S"]:
    """Return one depth in each of S equal bins between near and far [m].

    Args:
        near, far: depths [m].
        offsets: where in its bin each is, in [0, 1].
    """
    count = offsets.shape[-1]
    edges = torch.arange(count, device=offsets.device, dtype=torch.float32)
    near, far = _by_sample(near), _by_sample(far)
    return near + (far - near) * (edges + offsets) / count


def surface_samples(
    depth: Float[Tensor, "*B"], deviation: float, near: Limit, far: Limit, noise: Float[Tensor, "*B S"]
) -> Float[Tensor, "*B S"]:
    """Return depths around a known surface [m], within near and far; ``noise`` is in units of ``deviation`` [m]."""
    return (depth[..., None] + deviation * noise).clamp(_by_sample(near), _by_sample(far))  # type: ignore[arg-type]


def free_space_samples(
    depth: Float[Tensor, "*B"], reach: float, near: Limit, offsets: Float[Tensor, "*B S"]
) -> Float[Tensor, "*B S"]:
    """Return depths on the last stretch before a known surface [m], denser towards it.

    They are ``depth - reach u^2``, with u stratified in [0, 1] by ``offsets`` in [0, 1].
    """
    u = stratified_samples(0.0, 1.0, offsets)
    return (depth[..., None] - reach * u**2).clamp_min(_by_sample(near))


def _by_sample(limit: Limit) -> Tensor | float:
    return limit[..., None] if isinstance(limit, Tensor) else limit


def importance_samples(
    depths: Float[Tensor, "*B S"], weights: Float[Tensor, "*B S"], count: int
) -> Float[Tensor, "*B M"]:
    """Return ``count`` depths [m] spread evenly over the distribution that the weights of some samples describe.

    Inverse-transform sampling (NeRF, section 5.2) of the density that is constant between the midpoints of samples.
    """
    middles = 0.5 * (depths[..., 1:] + depths[..., :-1])
    edges = torch.cat([depths[..., :1], middles, depths[..., -1:]], dim=-1)
    mass = weights.detach() + 1e-5
    cumulative = torch.cumsum(mass / mass.sum(-1, keepdim=True), dim=-1)
    cumulative = torch.cat([torch.zeros_like(cumulative[..., :1]), cumulative], dim=-1)
    levels = (torch.arange(count, device=depths.device) + 0.5) / count
    levels = levels.expand(*depths.shape[:-1], count).contiguous()
    above = torch.searchsorted(cumulative, levels, right=True).clamp(1, edges.shape[-1] - 1)
    low, high = cumulative.gather(-1, above - 1), cumulative.gather(-1, above)
    fraction = (levels - low) / (high - low).clamp_min(1e-8)
    start, end = edges.gather(-1, above - 1), edges.gather(-1, above)
    return start + fraction.clamp(0.0, 1.0) * (end - start)


def widened_weights(weights: Float[Tensor, "*B S"]) -> Float[Tensor, "*B S"]:
    """Return weights by which to look for what lies between samples far apart.

    A surface between two samples shows in the second one's weight alone, whose share of the way to the first is half.
    So a sample has the mean of two maxima, of itself and the one before and of itself and the one after, as in mip-NeRF
    (2021), without the constant added there.
    """
    pairs = torch.maximum(weights[..., 1:], weights[..., :-1])
    pairs = torch.cat([weights[..., :1], pairs, weights[..., -1:]], dim=-1)
    return 0.5 * (pairs[..., 1:] + pairs[..., :-1])


def sample_spacings(
    depths: Float[Tensor, "*B S"], directions: Float[Tensor, "*B 3"], leave: Float[Tensor, "*B"] | None = None
) -> Float[Tensor, "*B S"]:
    """Return the length of ray that each sample stands for [m]; the last one, the backdrop, has all beyond.

    Args:
        depths: of the samples, sorted [m].
        directions: of the rays, of unit planar depth.
        leave: where each ray leaves the box that anything is in [m]. The last sample in the box stands for the way to
            there alone: the way on to the backdrop, which may be longer than that through the box, is empty.
    """
    lengths = _reaches(depths, leave) * directions.norm(dim=-1, keepdim=True)
    return torch.cat([lengths, torch.full_like(lengths[..., :1], 1e10)], dim=-1)


def _reaches(depths: Float[Tensor, "*B S"], leave: Float[Tensor, "*B"] | None) -> Float[Tensor, "*B S-1"]:
    """Return what each sample but the last stands for, in planar depth [m]."""
    ends = depths[..., 1:]
    if leave is not None:
        ends = torch.minimum(ends, torch.maximum(leave[..., None], depths[..., :-1]))
    return ends - depths[..., :-1]


def rendering_weights(density: Float[Tensor, "*B S"], spacings: Float[Tensor, "*B S"]) -> Float[Tensor, "*B S"]:
    """Return the share of each sample in its ray's colour, from density [1/m] and spacing [m]."""
    optical = density * spacings
    before = torch.cumsum(
        optical[..., :-1], dim=-1
    )  # without the backdrop's, next to which all others would round away
    before = torch.cat([torch.zeros_like(optical[..., :1]), before], dim=-1)
    return torch.exp(-before) * -torch.expm1(-optical)


def composite(weights: Float[Tensor, "*B S"], values: Float[Tensor, "*B S C"]) -> Float[Tensor, "*B C"]:
    """Return the weighted sum of values along rays."""
    return torch.einsum("...s,...sc->...c", weights, values)


def median_depth(
    weights: Float[Tensor, "*B S"], depths: Float[Tensor, "*B S"], leave: Float[Tensor, "*B"] | None = None
) -> Float[Tensor, "*B"]:
    """Return the depth [m] before which half of a ray's light comes from; of a ray that mostly passes, its last one.

    Where a ray may meet either of two surfaces, this is on one of them, where the expected depth is between them. The
    density between two samples is that of the first, as in the weights, so that transmittance falls to a half
    at ``t_i + delta_i ln(2 T_i) / (density_i delta_i)``.

    Args:
        weights: of the samples; those of a ray sum to one.
        depths: of the samples, sorted [m].
        leave: as :func:`sample_spacings` takes it.
    """
    absorbed = torch.cumsum(weights, dim=-1)
    first = (absorbed[..., :-1] < 0.5).sum(-1, keepdim=True)  # by the end of which half is absorbed
    weight = weights.gather(-1, first)
    before = (1.0 - (absorbed.gather(-1, first) - weight)).clamp(min=0.5)
    optical = -torch.log1p(-(weight / before).clamp(max=1.0))
    share = (torch.log(2.0 * before) / optical).clamp(0.0, 1.0)
    spacing = torch.cat([_reaches(depths, leave), torch.zeros_like(depths[..., :1])], dim=-1).gather(-1, first)
    return (depths.gather(-1, first) + share * spacing)[..., 0]
