"""Where the field lives: it follows from what is hit, however much empty background there is."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from nerf_rl import cli
from nerf_rl.cameras.geometry import camera_position, pixel_centres, pixel_directions
from nerf_rl.datasets.storage.reader import MultiViewDataset
from nerf_rl.datasets.storage.stored_manifest import DEPTH
from nerf_rl.errors import UserError
from nerf_rl.pretrain.config import PretrainConfig, SamplingConfig
from nerf_rl.pretrain.data import statistics
from nerf_rl.pretrain.data.statistics import class_change, measure
from nerf_rl.scenes.make import make_scene

CONFIG = PretrainConfig("data", "out")


@pytest.mark.parametrize("scene", ["gym/Pusher-v5", "gym/InvertedPendulum-v5"])
def test_empty_background_does_not_stretch_the_box(scene: str, tmp_path: Path):
    size = ["--episodes", "2", "--frames_per_episode", "3", "--episode_steps", "10", "--size", "40", "--workers", "1"]
    assert cli.main(["gen-dataset", "--scene", scene, "--out", str(tmp_path / "data"), *size]) == 0
    dataset = MultiViewDataset(tmp_path / "data")
    assert (dataset.read("depth") > 0.99 * dataset.manifest["far"]).mean() > 0.3  # most of it shows nothing
    bounds, workspace = measure(dataset, CONFIG).bounds, make_scene(scene).workspace()
    distance = workspace.distance(45.0)
    assert distance + 0.5 * workspace.radius < bounds.far < 4 * distance
    assert bounds.half_extent < 2.5 * workspace.radius
    things = dataset.read("state/privileged").reshape(len(dataset), -1, 3) - np.array(bounds.centre)
    assert (np.abs(things) < 2 * bounds.half_extent).all()


def test_the_box_holds_all_that_is_seen_before_the_backdrop(tiny_dataset: Path):
    dataset = MultiViewDataset(tiny_dataset)
    bounds = measure(dataset, CONFIG).bounds
    low, high = bounds.corners().numpy()
    frames, views = dataset.split("train"), dataset.views("encoder", "supervision")
    intrinsics, poses = (cameras[..., views, :, :] for cameras in dataset.tracked_cameras(frames))
    depth = dataset.read("depth", frames)[:, views]
    pixels = np.broadcast_to(pixel_centres(*depth.shape[2:]), (len(frames), len(views), depth[0, 0].size, 2))
    directions = pixel_directions(np.broadcast_to(intrinsics, poses[..., :3, :3].shape), poses, pixels)
    surface = camera_position(poses)[:, :, None] + depth.reshape(*depth.shape[:2], -1, 1) * directions
    seen = surface[depth.reshape(*depth.shape[:2], -1) < bounds.far]
    assert len(seen) > 10_000
    within = ((seen > low) & (seen < high)).all(-1)
    assert within.mean() > 0.999
    assert (np.ptp(seen, axis=0) > 0.8 * (high - low)).all()  # and little else


def test_there_is_no_box_where_it_is_not_asked_for_or_depth_is_unknown(
    tiny_dataset: Path, monkeypatch: pytest.MonkeyPatch
):
    dataset = MultiViewDataset(tiny_dataset)
    whole = measure(dataset, replace(CONFIG, sampling=SamplingConfig(scene_box=False))).bounds
    assert whole.low is None and whole.high is None
    monkeypatch.setattr(MultiViewDataset, "absent", property(lambda _: frozenset({DEPTH})))
    assert measure(dataset, CONFIG).bounds.low is None


def test_cameras_that_see_nothing_are_told(tiny_dataset: Path, monkeypatch: pytest.MonkeyPatch):
    dataset = MultiViewDataset(tiny_dataset)
    monkeypatch.setitem(dataset.manifest, "far", 0.01)
    with pytest.raises(UserError, match="the encoder's cameras see nothing at all; look at it with nerf-rl view"):
        measure(dataset, CONFIG)


def test_cameras_of_pictures_without_depth_may_be_as_far_away_as_their_units_make_them(
    tiny_dataset: Path, monkeypatch: pytest.MonkeyPatch
):
    dataset = MultiViewDataset(tiny_dataset)
    bounds = measure(dataset, CONFIG).bounds
    monkeypatch.setitem(dataset.manifest, "far", 0.01)
    monkeypatch.setattr(MultiViewDataset, "absent", property(lambda _: frozenset({DEPTH})))
    assert 0 < measure(dataset, CONFIG).bounds.near < bounds.far


def test_a_sample_of_the_pixels_tells_nearly_the_same(tiny_dataset: Path, monkeypatch: pytest.MonkeyPatch):
    dataset = MultiViewDataset(tiny_dataset)
    every = measure(dataset, CONFIG)
    looked_at: list[int] = []
    look = statistics._look

    def counted(*arguments):
        pixels, shown = look(*arguments)
        looked_at.append(len(pixels.depth))
        return pixels, shown

    monkeypatch.setattr(statistics, "_look", counted)
    monkeypatch.setattr(statistics, "_MOST_PIXELS", 3000)
    some = measure(dataset, CONFIG)
    assert looked_at[0] <= 3000 < dataset.read("depth").size
    assert some.bounds.far == pytest.approx(every.bounds.far, rel=0.03)
    assert some.bounds.half_extent == pytest.approx(every.bounds.half_extent, rel=0.1)
    np.testing.assert_array_equal(some.class_weights, every.class_weights)
    np.testing.assert_array_equal(some.pixel_weights, every.pixel_weights)


def test_a_pixel_changes_as_often_as_it_shows_another_class_than_usual():
    labels = np.array([[0, 1, 2], [0, 1, 1], [0, 1, 0], [0, 0, 2]])
    shown = np.stack([(labels == label).sum(0) for label in range(3)])[:, None, None]
    np.testing.assert_allclose(class_change(shown)[0, 0], [0.0, 0.25, 0.5])


def test_what_does_not_count_tells_nothing_of_the_scene(tiny_dataset: Path, monkeypatch: pytest.MonkeyPatch):
    """As if all but the robot were masked, in a dataset whose other pictures are of a table and a backdrop."""
    dataset = MultiViewDataset(tiny_dataset)
    whole, robot = measure(dataset, CONFIG), dataset.class_names.index("robot")
    monkeypatch.setattr(MultiViewDataset, "read_valid", lambda self, frames: self.read_labels(frames) == robot)
    found = measure(dataset, CONFIG)
    frames, views = dataset.split("train"), dataset.views("encoder")
    depth, labels = (read(frames)[:, views] for read in (lambda f: dataset.read("depth", f), dataset.read_labels))
    assert found.distance == pytest.approx(np.median(depth[labels == robot]))
    assert found.bounds.half_extent < 0.8 * whole.bounds.half_extent
    weights = found.class_weights / found.class_weights.min()
    assert weights.argmin() == robot and (np.delete(weights, robot) > 2).all(), "no other class was seen"


def test_a_pixel_that_never_counts_does_not_change():
    shown = np.zeros((2, 1, 1, 2), np.int64)
    shown[:, 0, 0, 0] = 3, 1
    assert class_change(shown).tolist() == [[[0.25, 0.0]]]


def test_where_nothing_was_hit_there_is_no_surface_however_far_away_things_are(
    tiny_dataset: Path, monkeypatch: pytest.MonkeyPatch
):
    dataset = MultiViewDataset(tiny_dataset)
    farthest = float(dataset.read("depth").max())
    monkeypatch.setitem(dataset.manifest, "far", farthest)
    assert measure(dataset, CONFIG).bounds.far < farthest
