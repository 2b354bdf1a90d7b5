"""Training batches: what they depend on, what their rays see, how rays are drawn."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import torch

from nerf_rl.cameras import geometry as cameras
from nerf_rl.datasets.storage.reader import MultiViewDataset
from nerf_rl.errors import UserError
from nerf_rl.pretrain.config import PretrainConfig, SamplingConfig
from nerf_rl.pretrain.data.batches import RayBatch, RayBatches
from nerf_rl.pretrain.data.data_module import MultiViewDataModule
from nerf_rl.pretrain.data.statistics import measure
from nerf_rl.pretrain.data.teachers import Pixels, Views, teacher_features

VIEW_NAMES = ("top", "left", "right", "random_0")  # the first is a test camera, the last one supervises only


@pytest.fixture
def dataset(tiny_dataset: Path) -> MultiViewDataset:
    """The tiny dataset; a test may change the roles that its manifest gives to cameras."""
    return MultiViewDataset(tiny_dataset)


@pytest.fixture
def config() -> Callable[..., PretrainConfig]:
    def make(**settings) -> PretrainConfig:
        return PretrainConfig("data", "out", scenes_per_step=3, **settings)

    return make


def batch_of(dataset: MultiViewDataset, config: PretrainConfig, step: int = 0) -> RayBatch:
    return RayBatches(dataset, config, measure(dataset, config))[step]


def frames_of(dataset: MultiViewDataset, batch: RayBatch) -> list[int]:
    """Return the frames whose encoder images a batch has."""
    stored = dataset.read("rgb")[:, [1, 2]]
    return [int(np.flatnonzero((stored == images.numpy()).all(axis=(1, 2, 3, 4)))[0]) for images in batch.images]


def test_a_batch_depends_on_the_seed_and_the_step_alone(dataset: MultiViewDataset, config):
    statistics = measure(dataset, config(seed=1))
    first = RayBatches(dataset, config(seed=1), statistics)
    expected = [first[step] for step in (0, 1, 2)]
    again = RayBatches(MultiViewDataset(dataset.folder), config(seed=1, steps=9), statistics)
    for step in (2, 0, 1):
        for mine, theirs in zip(again[step], expected[step], strict=True):
            assert torch.equal(mine, theirs)
    other_seed = RayBatches(dataset, config(seed=2), statistics)
    assert not torch.equal(other_seed[0].directions, expected[0].directions)
    assert not torch.equal(expected[1].directions, expected[0].directions)


def test_rays_reproject_onto_the_pixels_that_they_were_drawn_from(dataset: MultiViewDataset, config):
    settings = config(rays_per_scene=200, teachers=["normals", "depth"])
    batch, far = batch_of(dataset, settings), measure(dataset, settings).bounds.far
    seen = set()
    for scene, frame in enumerate(frames_of(dataset, batch)):
        rgb, semantic, depth = (dataset.read(name, [frame])[0] for name in ("rgb", "semantic", "depth"))
        intrinsics, poses = dataset.cameras([frame])
        centres = cameras.camera_position(poses[0])
        projections = dataset.projections([frame])[0]
        for ray in range(200):
            origin, direction = (
                batch.origins[scene, ray].double().numpy(),
                batch.directions[scene, ray].double().numpy(),
            )
            view = int(np.linalg.norm(centres - origin, axis=1).argmin())
            seen.add(VIEW_NAMES[view])
            np.testing.assert_allclose(origin, centres[view], atol=1e-6)
            surface = origin + float(batch.depth[scene, ray]) * direction
            pixels, planar = cameras.project(projections[view], surface[None])
            assert planar[0] == pytest.approx(float(batch.depth[scene, ray]), abs=1e-5)
            column, row = np.floor(pixels[0]).astype(int)
            np.testing.assert_allclose(pixels[0], [column + 0.5, row + 0.5], atol=1e-3)
            np.testing.assert_allclose(batch.rgb[scene, ray].numpy(), rgb[view, row, column] / 255, atol=1e-6)
            assert int(batch.semantic[scene, ray]) == semantic[view, row, column]
            assert float(batch.depth[scene, ray]) == pytest.approx(min(depth[view, row, column], far), rel=1e-6)
            place = Pixels(*(np.array([i]) for i in (view, row, column)))
            views = Views(rgb, depth, semantic, intrinsics, poses[0], far)
            feature = teacher_features(settings.teachers, views, place)
            np.testing.assert_allclose(batch.feature[scene, ray].numpy(), feature[0], atol=1e-5)
    assert seen == {"left", "right", "random_0"}  # a test camera never supervises


def test_images_and_matrices_are_those_of_the_encoders_cameras_in_training_frames(dataset: MultiViewDataset, config):
    held_out = set(dataset.split("validation").tolist())
    settings = config()
    statistics, drawn = measure(dataset, settings), set()
    for step in range(12):
        batch = RayBatches(dataset, settings, statistics)[step]
        frames = frames_of(dataset, batch)
        drawn |= set(frames)
        expected = dataset.projections(frames)[:, [1, 2]]
        np.testing.assert_allclose(batch.projections.numpy(), expected, rtol=1e-5, atol=1e-5)
    assert not drawn & held_out and len(drawn) == len(dataset.split("train"))


@pytest.mark.parametrize("balance", [0.0, 0.5, 1.0])
def test_rays_are_drawn_by_the_weights_of_classes(dataset: MultiViewDataset, config, balance: float):
    settings = config(class_balance=balance, change_boost=0.0, rays_per_scene=1500)
    train = dataset.split("train")
    labels = dataset.read("semantic", train)[:, 1:]
    frequency = np.bincount(labels.ravel(), minlength=len(dataset.class_names)) / labels.size
    weights = np.maximum(frequency, 1e-9) ** -balance
    expected, drawn = np.zeros(len(frequency)), np.zeros(len(frequency))
    for step in range(4):
        batch = batch_of(dataset, settings, step)
        drawn += np.bincount(batch.semantic.ravel(), minlength=len(frequency))
        for frame in frames_of(dataset, batch):
            counts = np.bincount(dataset.read("semantic", [frame])[0, 1:].ravel(), minlength=len(frequency))
            expected += 1500 * weights * counts / (weights * counts).sum()
    np.testing.assert_allclose(drawn / drawn.sum(), expected / expected.sum(), atol=0.02)


def test_rays_are_drawn_more_often_where_the_class_changes_from_frame_to_frame(dataset: MultiViewDataset, config):
    settings = config(class_balance=0.0, change_boost=20.0, rays_per_scene=1500)
    labels = dataset.read("semantic", dataset.split("train"))[:, 1:3]  # of the fixed cameras
    unusual = np.zeros(labels.shape[1:])
    for place in np.ndindex(unusual.shape):
        seen = labels[(slice(None), *place)]
        unusual[place] = 1 - np.bincount(seen).max() / len(seen)
    assert 0.01 < (unusual > 0).mean() < 0.6
    weights = np.concatenate([1 + 20 * unusual, np.full((1, 24, 24), 1 + 20 * unusual.mean())])
    counts = np.zeros(weights.shape)
    for step in range(4):
        batch = batch_of(dataset, settings, step)
        for scene, frame in enumerate(frames_of(dataset, batch)):
            centres = cameras.camera_position(dataset.cameras([frame])[1][0])
            view = np.linalg.norm(centres - batch.origins[scene, :, None].double().numpy(), axis=-1).argmin(1)
            points = batch.origins[scene] + batch.directions[scene]
            pixels = cameras.project(dataset.projections([frame])[0][view], points[:, None].double().numpy())[0]
            column, row = np.floor(pixels[:, 0]).astype(int).T
            np.add.at(counts, (view - 1, row, column), 1)
    for part in (weights[:2] > 1, weights[:2] == 1):
        expected = weights[:2][part].sum() / weights.sum()
        assert counts[:2][part].sum() / counts.sum() == pytest.approx(expected, abs=0.02)


def test_bounds_hold_what_the_encoders_cameras_see(dataset: MultiViewDataset, config):
    bounds = measure(dataset, config()).bounds
    every = dataset.read("depth", dataset.split("train"))[:, [1, 2, 3]]
    depth = every[:, :2]
    assert np.quantile(every, 0.01) < 0.5 * depth.min()  # the camera that moves comes closer
    assert bounds.near < depth.min() and every.min() < 2 * bounds.near
    assert (every < bounds.near).mean() < 0.002
    hit = depth < 0.99 * dataset.manifest["far"]
    assert 0.1 < (~hit).mean() < 0.3  # of the pixels show the sky
    assert bounds.far == pytest.approx(2.5 * np.median(depth[hit]), rel=1e-5)
    objects = dataset.read("state/privileged").reshape(-1, 3)  # hand, handle and goal
    assert (np.abs(objects - np.array(bounds.centre)) < bounds.half_extent).all()


def test_depth_limits_of_the_recipe_are_kept(dataset: MultiViewDataset, config):
    bounds = measure(dataset, config(sampling=SamplingConfig(near=0.2, far=3.0))).bounds
    assert (bounds.near, bounds.far) == (0.2, 3.0)
    with pytest.raises(UserError, match=r"sampling needs 0 < near < far, got near 9\.000"):
        measure(dataset, config(sampling=SamplingConfig(near=9.0)))


def test_depth_limits_come_from_the_encoders_cameras_wherever_they_stand(dataset: MultiViewDataset, config):
    for camera, role in zip(
        dataset.manifest["cameras"], ("supervision", "supervision", "encoder", "test"), strict=True
    ):
        camera["role"] = role
    depth = dataset.read("depth", dataset.split("train"))[:, [2]]
    hit = depth < 0.99 * dataset.manifest["far"]
    assert measure(dataset, config()).bounds.far == pytest.approx(2.5 * np.median(depth[hit]), rel=1e-5)


@pytest.mark.parametrize("near", [None, 0.7])
def test_no_ray_tells_of_a_surface_before_its_beginning(dataset: MultiViewDataset, config, near: float | None):
    settings = config(rays_per_scene=400, sampling=SamplingConfig(near=near))
    nearest = measure(dataset, settings).bounds.near
    drawn = torch.cat([batch_of(dataset, settings, step).depth for step in range(3)])
    assert nearest <= float(drawn.min()) < 1.5 * nearest  # such as there are in the pictures
    if near is not None:
        assert (dataset.read("depth", dataset.split("train"))[:, [1, 2, 3]] < near).mean() > 0.01


def test_rays_are_of_the_few_pixels_that_count_even_if_there_is_one(
    dataset: MultiViewDataset, config, monkeypatch: pytest.MonkeyPatch
):
    read = MultiViewDataset.read

    def hardly_valid(self: MultiViewDataset, frames: np.ndarray) -> np.ndarray:
        valid = np.zeros(read(self, "semantic", frames).shape, np.bool_)
        valid[:, 1, 3, 4] = True
        return valid

    settings = config(rays_per_scene=2)
    statistics = measure(dataset, settings)
    monkeypatch.setattr(MultiViewDataset, "read_valid", hardly_valid)
    for step in range(5):
        batch = RayBatches(dataset, settings, statistics)[step]
        for frame, rgb in zip(frames_of(dataset, batch), batch.rgb.numpy(), strict=True):
            truth = read(dataset, "rgb", [frame])[0, 1, 3, 4] / np.float32(255)
            np.testing.assert_allclose(rgb, np.broadcast_to(truth, rgb.shape), atol=1e-6)


def test_epochs_divide_the_steps_among_them_and_validation_frames_are_held_out(dataset: MultiViewDataset, config):
    module = MultiViewDataModule(dataset, config(steps=5, steps_per_epoch=3, validation_frames=2))
    batches = RayBatches(dataset, config(steps=5), module.statistics)
    steps = []
    for _ in range(2):
        module.trainer = type("Trainer", (), {"global_step": len(steps)})()  # type: ignore[assignment]
        for batch in module.train_dataloader():
            matching = [step for step in range(6) if torch.equal(batches[step].directions, batch.directions)]
            steps += matching
    assert steps == [0, 1, 2, 3, 4]
    frames = [int(frame) for frame in module.val_dataloader()]
    assert len(frames) == 2 and set(frames) <= set(dataset.split("validation").tolist())
