"""Feature planes that go with things that move: where they are looked up, and what they can show."""

import pytest
import torch

from nerf_rl.pretrain.model.feature_planes import ObjectPlanes, project, sample

ORIGINS = torch.tensor([[[0.0, 0.0, 0.0], [0.5, 0.1, -0.2]]])
SMALL, LARGE = 0.05, 0.4


def make_planes(sizes: tuple[float, float] = (LARGE, SMALL), cells: int = 8) -> ObjectPlanes:
    torch.manual_seed(0)
    planes = ObjectPlanes(2, cells, 3)
    planes.place(torch.tensor(sizes))
    return planes


def around(origin: torch.Tensor, reach: float, count: int = 200) -> torch.Tensor:
    generator = torch.Generator().manual_seed(1)
    return origin + reach * (2 * torch.rand((1, count, 3), generator=generator) - 1)


def test_planes_are_looked_up_between_the_middles_of_their_cells() -> None:
    planes = torch.zeros(3, 1, 4, 4)
    planes[0, 0, 1, 2], planes[1, 0, 3, 0], planes[2, 0] = 1.0, 2.0, 3.0
    middle = torch.tensor([-0.75, -0.25, 0.25, 0.75])  # of the cells
    points = torch.tensor([[middle[2], middle[1], 0.9], [middle[0], 0.9, middle[3]], [0.0, middle[1], 0.9]])
    expected = torch.tensor([[1.0, 0.0, 3.0], [0.0, 2.0, 3.0], [0.5, 0.0, 3.0]])
    torch.testing.assert_close(sample(planes, project(points)), expected)


@pytest.mark.parametrize("thing", [0, 1])
def test_what_planes_hold_goes_with_their_frame(thing: int) -> None:
    planes, step = make_planes(), torch.tensor([0.05, -0.2, 0.1])
    moved = ORIGINS.clone()
    moved[0, thing] += step
    points = around(ORIGINS[0, thing], float(planes.reach[thing]))

    def in_the_smaller_box(points: torch.Tensor, origins: torch.Tensor) -> torch.Tensor:
        return (points - origins[:, 1]).abs().amax(-1) < planes.reach[1]

    own = torch.ones(1, 200, dtype=torch.bool)
    if thing == 0:
        own = ~(in_the_smaller_box(points, ORIGINS) | in_the_smaller_box(points + step, moved))
    held = planes(points, ORIGINS)[own]
    assert own.sum() > 150 and held.abs().max() > 0.1
    torch.testing.assert_close(planes(points + step, moved)[own], held, atol=1e-5, rtol=1e-4)


def test_a_point_is_looked_up_in_the_smallest_box_that_holds_it() -> None:
    near = torch.tensor([[[0.0, 0.0, 0.0], [0.1, 0.0, 0.0]]])
    for sizes in ((LARGE, SMALL), (SMALL, LARGE)):
        planes = make_planes(sizes)
        small = sizes.index(SMALL)
        with torch.no_grad():
            cells = planes.size
            planes.planes.zero_()
            planes.planes[..., small * cells : (small + 1) * cells] = 1.0
        inside = around(near[0, small], 0.9 * float(planes.reach[small]))
        outside = inside + torch.tensor([0.0, 2.2 * float(planes.reach[small]), 0.0])
        assert planes(inside, near).min() > 0.1
        assert planes(outside, near).abs().max() == 0.0  # in the larger box, with nothing of its neighbour's columns


def test_planes_fade_at_the_faces_of_their_box_and_end_there() -> None:
    planes = make_planes()
    directions = torch.eye(3).repeat(2, 1) * torch.tensor([1.0, 1, 1, -1, -1, -1])[:, None]
    for share, largest in ((0.999, 1e-3), (1.001, 0.0), (50.0, 0.0)):
        points = ORIGINS[:, 1] + share * planes.reach[1] * directions
        alone = torch.cat([torch.full((1, 1, 3), 100.0), ORIGINS[:, 1:]], dim=1)  # the other thing is far away
        assert planes(points[None], alone).abs().max() <= largest


def test_a_thing_without_extent_is_looked_up_without_harm() -> None:
    planes = make_planes((LARGE, 0.0))
    points = torch.cat([ORIGINS[:, 1:], around(ORIGINS[0, 1], SMALL)], dim=1)
    assert planes(points, ORIGINS).isfinite().all()


def test_planes_learn_and_points_and_origins_do_not() -> None:
    planes, origins = make_planes(), ORIGINS.clone().requires_grad_()
    planes(around(ORIGINS[0, 1], SMALL), origins).square().sum().backward()
    assert origins.grad is None and planes.planes.grad.abs().sum() > 0
    assert planes.planes.grad[..., : planes.size].abs().sum() == 0  # of the thing that was not there


def test_edges_that_are_finer_than_waves_can_be_drawn() -> None:
    """A checkerboard of the planes' own cells is learnt to a hundredth; the field's finest wave is coarser than it."""
    planes = make_planes(cells=16)
    points = around(ORIGINS[0, 1], 0.6 * float(planes.reach[1]), 4000)
    local = (points - ORIGINS[:, 1]) / planes.reach[1]
    inside = (1 - 1 / 16) * local[..., :2]
    cell = ((inside + 1) * 8).floor()
    near_middle = ((inside + 1) * 8 - cell - 0.5).abs().amax(-1) < 0.1
    wanted = (cell.sum(-1) % 2)[near_middle]
    optimiser = torch.optim.Adam(planes.parameters(), lr=0.05)
    for _ in range(200):
        error = (planes(points, ORIGINS)[near_middle].sum(-1) - wanted).square().mean()
        optimiser.zero_grad()
        error.backward()
        optimiser.step()
    assert wanted.mean() > 0.3 and error.item() < 0.01
