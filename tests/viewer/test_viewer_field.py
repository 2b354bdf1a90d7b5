"""The field as the viewer renders it, against the plain renderer; its surface, latents and probe."""

import copy
import dataclasses
from functools import partial
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import torch

from nerf_rl.cameras.geometry import pixel_centres, pixel_directions
from nerf_rl.datasets.storage.frames import Frame, read_frame
from nerf_rl.datasets.storage.reader import MultiViewDataset
from nerf_rl.pretrain.config import SamplingConfig
from nerf_rl.pretrain.measures.linear_probe import encode_frames
from nerf_rl.pretrain.model.conditioned_field import ConditionedField
from nerf_rl.pretrain.model.field import FieldBounds, RadianceField
from nerf_rl.pretrain.model.ray_rendering import render_images
from nerf_rl.viewer.field import progressive
from nerf_rl.viewer.field.density_mesh import density_mesh, surface_net
from nerf_rl.viewer.field.field_panel import FieldPanel, Pace
from nerf_rl.viewer.field.latents import EncodedDataset
from nerf_rl.viewer.field.progressive import FreeCamera, Picture, render_progressively
from nerf_rl.viewer.field.reconstruction import errors, render_views
from nerf_rl.viewer.pages.agent_pictures import decode_views
from nerf_rl.viewer.pages.encoder_view import probe_table
from nerf_rl.viewer.server import serve


@pytest.fixture(scope="module")
def encoded(tiny_encoder: Path, tiny_dataset: Path) -> EncodedDataset:
    return EncodedDataset(str(tiny_encoder), tiny_encoder, MultiViewDataset(tiny_dataset))


@pytest.fixture(scope="module")
def frame(encoded: EncodedDataset) -> Frame:
    return read_frame(encoded.dataset, 4)


def with_surfaces(field: RadianceField, latent: torch.Tensor) -> RadianceField:
    """Return a field that is solid where the given one is densest, in a fifth of its box, and empty elsewhere."""
    points = 2 * torch.rand(1, 4000, 3, generator=torch.Generator().manual_seed(0)) - 1
    solid = copy.deepcopy(field).requires_grad_(False)
    density = solid(solid.centre + solid.bounds.half_extent * points, latent[None])[0] / solid.density_scale
    least = density.expm1().log().quantile(0.8)  # before softplus
    solid.density_head.bias -= least
    solid.density_head.weight *= 100.0
    solid.density_head.bias *= 100.0
    return solid


@pytest.mark.parametrize("samples, apart", [(None, 0.1), (32, 0.05)])
def test_the_finest_image_is_what_the_plain_renderer_gives(
    encoded: EncodedDataset, frame: Frame, samples: int | None, apart: float
) -> None:
    """Of surfaces, as fields show that have been trained for longer than this one: the depth of fog is anybody's."""
    latent, rig = encoded.latent(frame), encoded.encoder.rig
    field = with_surfaces(encoded.field, latent)
    camera = FreeCamera(rig.camera_from_world[0], np.deg2rad(45.0), 1.0)
    fine = Picture(24) if samples is None else Picture(24, samples)
    images = list(render_progressively(ConditionedField(field, latent), camera, 12, [fine, Picture(48)]))
    assert [image.rgb.shape for image in images] == [(1, 12, 12, 3), (1, 24, 24, 3), (1, 48, 48, 3)]
    plain = render_images(field, latent, rig.intrinsics[:1], rig.camera_from_world[:1], 24, 24, SamplingConfig())
    assert plain.depth.std() > 0.1  # there is something to be wrong about
    assert np.abs(images[1].rgb - plain.rgb).mean() < 0.03
    assert np.abs(images[1].depth - plain.depth).mean() < apart


@pytest.mark.parametrize("wall", np.linspace(1.0, 1.1, 7).tolist())
def test_coarse_rays_close_in_on_a_surface_from_both_sides(wall: float) -> None:
    class Wall(ConditionedField):
        def __init__(self) -> None:
            self.field = SimpleNamespace(bounds=SimpleNamespace(far=2.0))  # type: ignore[assignment]

        def __call__(self, points: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
            return torch.where(points[:, 2] > wall, 2000.0, 0.0), points

    every = torch.linspace(0.05, 1.95, 20)[None]
    ahead, limits = torch.tensor([[0.0, 0.0, 1.0]]), (torch.tensor([0.0]), torch.tensor([2.0]))
    sight = progressive._render_twice(Wall(), progressive._Rays(torch.zeros(3), ahead, *limits), every)
    assert sight.depths[sight.depths > wall].min() - sight.depths[sight.depths <= wall].max() < 0.045


class WhiteFog(ConditionedField):
    """Thin white fog in a box one metre ahead, and black everywhere else."""

    density = 1.5

    def __init__(self, far: float) -> None:
        bounds = FieldBounds(0.3, far, (0.0, 0.0, 1.0), 1.0, (-0.2, -0.3, 0.9), (0.3, 0.2, 1.2))
        self.box = SimpleNamespace(bounds=bounds, corners=bounds.corners())
        self.box.read = lambda seen: {"rgb": seen, "semantic": seen}
        self.box.ray_limits = partial(RadianceField.ray_limits, self.box)  # type: ignore[arg-type]
        self.field, self.latent = self.box, torch.zeros(1)  # type: ignore[assignment]

    def __call__(self, points: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        inside = RadianceField.in_box(self.box, points).float()  # type: ignore[arg-type]
        return self.density * inside, inside[:, None].expand(-1, 3)


@pytest.mark.parametrize("far", [2.0, 50.0])
def test_fog_in_a_box_is_as_thick_from_the_viewer_however_far_the_backdrop_is(far: float) -> None:
    """The last sample in the box once stood for the way on to the backdrop as well."""
    fog, camera = WhiteFog(far), FreeCamera(np.eye(4), np.deg2rad(30.0), 1.0)
    for picture in render_progressively(fog, camera, 12, [Picture(24), Picture(24, 32)]):
        height, width = picture.depth.shape[1:]
        origin, directions = camera.rays(height, width)
        enter, leave = fog.box.ray_limits(origin.expand_as(directions), directions)
        way = (leave - enter) * directions.norm(dim=-1)
        most = (1.0 - torch.exp(-fog.density * way)).reshape(height, width).numpy()
        assert (most > 0.3).any() and (most == 0.0).any()
        assert (picture.rgb[0] <= most[..., None] + 1e-5).all()
        assert picture.rgb[0].max() > 0.5 * most.max()  # the fog is there


def test_a_newer_picture_cancels_the_finer_ones(encoded: EncodedDataset, frame: Frame) -> None:
    camera = FreeCamera(encoded.encoder.rig.camera_from_world[0], 0.8, 1.5)
    seen: list[int] = []
    for image in render_progressively(
        encoded.folded(encoded.latent(frame)), camera, 12, [Picture(24)], lambda: bool(seen)
    ):
        seen.append(image.rgb.shape[2])
    assert seen == [12]


def test_pictures_of_a_moving_camera_get_grainier_where_they_take_long_and_finer_where_they_do_not() -> None:
    pace = Pace()
    begun = pace.samples
    pace.took(Pace.SLOW + 0.01)
    assert pace.samples == begun - 1
    pace.took((Pace.QUICK + Pace.SLOW) / 2)
    assert pace.samples == begun - 1
    for seconds, limit in ((9.0, Pace.FEWEST), (0.0, Pace.MOST)):
        for _ in range(20):
            pace.took(seconds)
        assert pace.samples == limit


def test_a_camera_has_the_rays_of_its_field_of_view() -> None:
    camera = FreeCamera(np.eye(4), np.deg2rad(90.0), 2.0)
    assert camera.shape(128) == (64, 128)
    origin, directions = camera.rays(2, 4)
    assert origin.tolist() == [0.0, 0.0, 0.0]
    assert np.allclose(directions[0], [-1.5, -0.5, 1.0]) and np.allclose(directions[-1], [1.5, 0.5, 1.0])


def test_cameras_that_are_not_centred_are_decoded_where_they_looked(encoded: EncodedDataset, frame: Frame) -> None:
    """Pixels that are not square, and a principal point far from the middle, as a cropped picture has it."""
    latent, rig = encoded.latent(frame), encoded.encoder.rig
    K = np.array([[31.0, 0.0, 7.0], [0.0, 24.0, 16.0], [0.0, 0.0, 1.0]])
    rig = dataclasses.replace(rig, intrinsics=np.stack([K] * len(rig.names)))
    frame = dataclasses.replace(frame, intrinsics=np.stack([K] * len(frame.intrinsics)))
    field = with_surfaces(encoded.field, latent)
    plain = render_images(field, latent, K[None], rig.camera_from_world[:1], 24, 24, SamplingConfig())
    (first,) = encoded.dataset.views("encoder")[:1]
    for rendered in (
        render_views(ConditionedField(field, latent), *frame.cameras([first])),
        decode_views(ConditionedField(field, latent), rig),
    ):
        assert rendered is not None and np.abs(rendered[0].rgb - plain.rgb).mean() < 0.03
        assert np.abs(rendered[0].depth - plain.depth).mean() < 0.1


def test_a_picture_of_another_size_has_the_rays_of_the_same_camera() -> None:
    K, pose = np.array([[31.0, 0.0, 7.0], [0.0, 24.0, 16.0], [0.0, 0.0, 1.0]]), np.eye(4)
    camera = FreeCamera.of_view(K, pose, height=20, width=30)
    assert camera.shape(30) == (20, 30) and camera.shape(60) == (40, 60)
    for factor in (1, 2):
        directions = camera.rays(20 * factor, 30 * factor)[1]
        expected = pixel_directions(K, pose, pixel_centres(20 * factor, 30 * factor) / factor)
        assert np.allclose(directions, expected, atol=1e-6)


def test_a_surface_net_of_a_ball_has_its_volume_and_faces_outwards() -> None:
    grid = np.stack(np.meshgrid(*[np.linspace(-1.0, 1.0, 40)] * 3, indexing="ij"), axis=-1)
    vertices, faces = surface_net(0.7 - np.linalg.norm(grid, axis=-1), 0.0)
    points = vertices * (2.0 / 39.0) - 1.0
    assert np.abs(np.linalg.norm(points, axis=-1) - 0.7).max() < 0.01
    a, b, c = (points[faces[:, i]] for i in range(3))
    volume = np.einsum("fi,fi->f", a, np.cross(b, c)).sum() / 6.0
    assert np.isclose(volume, 4.0 / 3.0 * np.pi * 0.7**3, rtol=0.02)
    edges = np.sort(np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]]), axis=1)
    assert (np.unique(edges, axis=0, return_counts=True)[1] == 2).all()  # watertight


def test_the_mesh_goes_where_nothing_has_that_density(
    encoded: EncodedDataset, frame: Frame, monkeypatch: pytest.MonkeyPatch
) -> None:
    triangle = np.eye(3), np.array([[0, 1, 2]]), np.zeros((3, 3))
    nothing = np.zeros((0, 3)), np.zeros((0, 3), int), np.zeros((0, 3))
    found = [triangle]
    monkeypatch.setattr("nerf_rl.viewer.field.field_panel.density_mesh", lambda field, level: found[-1])
    with serve("127.0.0.1", 0, "test") as server:
        panel = FieldPanel(server, encoded.dataset.palette, (0.1, 2.0))
        panel.mode.value, panel._field = "density mesh", encoded.folded(encoded.latent(frame))
        shown = []
        for mesh in (triangle, nothing):
            found.append(mesh)
            panel._mesh_worker.wait(30.0)  # the choice of a mode has one drawn, too
            panel._draw_mesh(None, lambda: False)
            assert panel._mesh is not None
            shown.append(panel._mesh.visible)
        panel.close()
    assert shown == [True, False]


def test_the_mesh_of_a_density_lies_where_the_field_has_that_density(encoded: EncodedDataset, frame: Frame) -> None:
    folded = encoded.folded(encoded.latent(frame))
    centre = torch.tensor([encoded.field.bounds.centre])
    level = float(folded(centre + 0.2 * torch.rand(200, 3))[0].median())
    points, faces, colours = density_mesh(folded, level, resolution=24)
    assert len(faces) and colours.shape == points.shape
    density = folded(torch.from_numpy(points))[0]
    assert np.abs(np.asarray(density) / level - 1.0).mean() < 0.1


def test_latents_are_the_encoders(encoded: EncodedDataset, frame: Frame) -> None:
    expected = encode_frames(encoded.encoder, encoded.dataset, np.array([4]))[0]
    assert np.allclose(encoded.latent(frame), expected, atol=1e-5)


def test_the_probe_reads_its_training_frames_and_the_table_tells_the_error(encoded: EncodedDataset) -> None:
    probe = encoded.fit_probe()
    assert set(probe.names) <= set(encoded.dataset.columns("privileged"))
    read = probe.read(torch.from_numpy(probe.latents[0]).float())
    assert set(read) == set(probe.names)
    table = probe_table({"hand_x": 0.1}, {"hand_x": 0.098})
    assert "100.0" in table and "98.0" in table and "2.0" in table


def test_errors_are_black_for_a_perfect_rendering(encoded: EncodedDataset, frame: Frame) -> None:
    rendered = render_views(encoded.folded(encoded.latent(frame)), *frame.cameras([0]))
    assert rendered is not None and rendered[0].rgb.shape == (1, 24, 24, 3)
    rendered[0].rgb[0] = frame.rgb[0] / 255.0
    rendered[0].semantic[0], rendered[0].depth[0] = frame.semantic[0], frame.depth[0]
    assert all(picture.max() < 5 for picture in errors(frame, 0, rendered[0], far=2.0))


@pytest.mark.parametrize(("device", "parts"), [("cpu", 4), ("cuda:0", 1)])
def test_a_gpu_renders_a_picture_in_one_part_and_processors_in_several(
    device: str, parts: int, monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.setattr(progressive, "_thread_count", lambda: 2)
    rendered: list[slice] = []

    def render(part: slice) -> progressive._Sight:
        rendered.append(part)
        places = torch.arange(1000.0)[part, None]
        return progressive._Sight(places, places, places, places[:, 0])

    whole = progressive._in_chunks(render, 1000, lambda: False, torch.device(device))
    assert whole is not None and torch.equal(whole.depths[:, 0], torch.arange(1000.0))
    assert len(rendered) == parts
