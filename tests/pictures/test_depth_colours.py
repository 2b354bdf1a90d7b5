"""The colours of depth in pictures: they tell the scene's surfaces apart, however far off the far plane is."""

import cv2
import numpy as np
import pytest

from nerf_rl import cli
from nerf_rl.datasets.storage.frames import read_frame
from nerf_rl.datasets.storage.reader import MultiViewDataset
from nerf_rl.pictures.images import colour_depth, surface_limits
from nerf_rl.report.contact_sheet import contact_sheet
from nerf_rl.scenes.make import make_scene
from nerf_rl.viewer.drawing.pictures import camera_strip, depth_limits
from nerf_rl.viewer.panels.scene_panel import ScenePanel
from nerf_rl.viewer.server import serve

_SCALE = cv2.applyColorMap(np.arange(256, dtype=np.uint8)[:, None], cv2.COLORMAP_VIRIDIS)[:, 0, ::-1].astype(int)


def levels(picture: np.ndarray) -> np.ndarray:
    """Return the place of each pixel's colour on the scale, 0 (far) to 255 (near)."""
    return np.abs(picture.astype(int)[..., None, :] - _SCALE).sum(-1).argmin(-1)


@pytest.fixture(scope="module", params=["gym/Pusher-v5", "gym/Reacher-v5", "gym/InvertedPendulum-v5"])
def dataset(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> MultiViewDataset:
    out = tmp_path_factory.mktemp("dataset") / "x"
    keys = "--episodes 2 --frames_per_episode 2 --episode_steps 8 --episodes_per_shard 2 --size 40 --workers 1"
    assert cli.main(["gen-dataset", "--scene", request.param, "--out", str(out), *keys.split()]) == 0
    return MultiViewDataset(out)


def spanned(depth: np.ndarray, level: np.ndarray, dataset: MultiViewDataset) -> float:
    """Return the share of the scale that the ball of what moves takes up, from its near side to its far side."""
    workspace = make_scene(dataset.manifest["scene"]["name"]).workspace()
    _, poses = dataset.cameras([0])
    shares = []
    for view in range(depth.shape[0]):
        middle = float((poses[0, view, :3, :3] @ workspace.centre + poses[0, view, :3, 3])[2])
        inside = np.abs(depth[view] - middle) < workspace.radius
        shares.append((level[view][inside].max() - level[view][inside].min()) / 255.0)
    return float(np.mean(shares))


def test_the_workspace_takes_most_of_the_colours(dataset: MultiViewDataset) -> None:
    frame = read_frame(dataset, 0)
    strips = [camera_strip(frame, v, dataset.palette, depth_limits(frame), 40) for v in range(len(frame.depth))]
    level = levels(np.stack([strip[:, -40:] for strip in strips]))
    assert spanned(frame.depth, level, dataset) > 0.55
    background = frame.depth > 0.99 * dataset.manifest["far"]
    assert (level[background] == 0).all()


def test_a_contact_sheet_has_the_same_colours(dataset: MultiViewDataset) -> None:
    count = len(dataset.camera_names)
    sheet = contact_sheet(dataset, [0], factor=1)[-42:-2]
    level = levels(np.stack([sheet[:, 42 * view : 42 * view + 40] for view in range(count)]))
    assert spanned(dataset.read("depth", [0])[0], level, dataset) > 0.55


def test_limits_do_not_depend_on_how_much_background_there_is_nor_how_far_it_is() -> None:
    surfaces = np.random.default_rng(0).uniform(0.8, 1.6, 1000)
    wanted = surface_limits(surfaces, 50.0)
    for far, count in ((20.0, 1), (200.0, 10_000), (5e4, 300)):
        assert surface_limits(np.append(surfaces, np.full(count, far)), far) == wanted
    assert 0.8 <= wanted[0] < 0.82 and 1.35 < wanted[1] < 1.6


def test_a_single_near_pixel_takes_no_colours_away() -> None:
    depth = np.append(np.linspace(1.0, 2.0, 1000), 0.01)
    assert surface_limits(depth, 9.0)[0] > 0.99


@pytest.mark.parametrize("depth", [np.full((4, 4), 30.0), np.full((4, 4), 1.0)])
def test_a_picture_of_nothing_or_of_one_plane_is_one_colour(depth: np.ndarray) -> None:
    level = levels(colour_depth(depth, *surface_limits(depth, 30.0)))
    assert (level == (0 if depth[0, 0] == 30.0 else 255)).all()


def test_the_page_begins_with_a_look_at_the_workspace(dataset: MultiViewDataset) -> None:
    with serve("127.0.0.1", 0, "test") as server:
        ScenePanel(server, dataset, read_frame(dataset, 0), lambda: None)
        middle = np.array(server.initial_camera.look_at)
    workspace = make_scene(dataset.manifest["scene"]["name"]).workspace()
    assert np.linalg.norm(middle - workspace.centre) < 3 * workspace.radius
