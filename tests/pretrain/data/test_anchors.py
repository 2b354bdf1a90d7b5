"""What frames of the field follow: the visible middles of classes, from labels and depth alone."""

from pathlib import Path

import numpy as np
import pytest
import torch

from nerf_rl.datasets.storage.point_cloud import unproject
from nerf_rl.datasets.storage.reader import MultiViewDataset
from nerf_rl.pretrain.config import FieldConfig, PretrainConfig
from nerf_rl.pretrain.data.anchors import (
    Anchors,
    FollowedMiddles,
    Middles,
    choose_anchors,
    visible_middles,
    visible_sizes,
)
from nerf_rl.pretrain.data.batches import RayBatches
from nerf_rl.pretrain.data.data_module import MultiViewDataModule
from nerf_rl.pretrain.data.statistics import measure
from nerf_rl.pretrain.objectives.snerl_module import SnerlModule


@pytest.fixture
def dataset(tiny_dataset: Path) -> MultiViewDataset:
    return MultiViewDataset(tiny_dataset)


def middles_of(dataset: MultiViewDataset) -> Middles:
    frames = np.arange(len(dataset))
    intrinsics, poses = dataset.cameras(frames)
    return visible_middles(dataset.read("depth"), dataset.read_labels(frames), intrinsics, poses, 5)


def test_a_middle_is_the_mean_of_the_points_that_pixels_show_and_a_size_how_far_they_are_from_it(
    dataset: MultiViewDataset,
):
    """Through the point clouds' own unprojection, with a camera that moves among the others."""
    middles = middles_of(dataset)
    intrinsics, poses = dataset.cameras(np.arange(len(dataset)))
    depth, labels = dataset.read("depth"), dataset.read_labels(np.arange(len(dataset)))
    sizes = visible_sizes(depth, labels, intrinsics, poses, middles)
    assert len(dataset.class_names) == 5 and np.abs(poses - poses[:1]).max() > 0.01
    hidden = 0
    for frame in range(len(dataset)):
        points = np.stack([unproject(depth[frame, v], intrinsics[v], poses[frame, v]) for v in range(depth.shape[1])])
        for label in range(1, 5):
            shown = points[labels[frame] == label]
            hidden += len(shown) < 6
            assert middles.seen[frame, label] == (len(shown) >= 6)
            expected = shown.mean(0) if len(shown) >= 6 else np.zeros(3)
            np.testing.assert_allclose(middles.place[frame, label], expected, atol=1e-6)
            apart = np.sqrt(((shown - expected) ** 2).sum(1).mean()) if len(shown) >= 6 else 0.0
            np.testing.assert_allclose(sizes[frame, label], apart, atol=1e-6)
    assert not middles.seen[:, 0].any()  # nothing follows the background


def test_a_class_of_few_pixels_is_not_seen():
    depth, labels = np.ones((1, 1, 8, 8)), np.zeros((1, 1, 8, 8), np.uint8)
    labels[0, 0, 2, :5] = 1
    camera = np.array([[[8.0, 0, 4], [0, 8, 4], [0, 0, 1]]]), np.eye(4)[None, None]
    assert not visible_middles(depth, labels, *camera, 2).seen.any()
    labels[0, 0, 2, 5] = 1
    middles = visible_middles(depth, labels, *camera, 2)
    assert middles.seen.tolist() == [[False, True]]
    np.testing.assert_allclose(middles.place[0, 1], [(3.0 - 4) / 8, (2.5 - 4) / 8, 1.0])


def test_classes_that_stay_or_are_hardly_ever_seen_are_not_followed():
    rng = np.random.default_rng(0)
    place, seen = np.zeros((200, 5, 3)), np.ones((200, 5), bool)
    place[:, 1] = [0.3, 0.2, 0.1] + 1e-4 * rng.standard_normal((200, 3))  # a fixture
    place[:, 2] = 0.05 * rng.standard_normal((200, 3))
    place[:, 3] = rng.standard_normal((200, 3))
    seen[3:, 3] = False  # three frames of two hundred
    place[:, 4] = [0.5, 0.5, 0.0] + 0.02 * rng.standard_normal((200, 3))
    seen[::2, 4] = False
    seen[:, 0] = False
    place[~seen] = 0.0
    sizes = np.where(seen, [9.0, 9.0, 0.3, 9.0, 0.1], 0.0)
    share = np.array([0.6, 0.1, 0.2, 0.06, 0.04])
    anchors = choose_anchors(Middles(place, seen), sizes, share, distance=1.0)
    assert anchors.classes == (2, 4) and anchors.seldom == (3,)
    names = ["background", "fixture", "block", "ball", "hand"]
    told = "following what moves: block, hand; hardly any picture shows ball, so z is not told where that is"
    assert anchors.describe(names) == told
    assert anchors._replace(seldom=()).describe(names) == "following what moves: block, hand"
    np.testing.assert_allclose(anchors.mean, [[0, 0, 0], [0.5, 0.5, 0.0]], atol=0.02)
    assert anchors.share.tolist() == [0.2, 0.04]
    np.testing.assert_allclose(anchors.size, [0.3, 0.1])
    np.testing.assert_allclose(anchors.spread, [0.05 * 3**0.5, 0.02 * 3**0.5], rtol=0.15)
    assert choose_anchors(Middles(place, seen), sizes, share, distance=25.0).classes == (2,)  # seen from far off
    assert choose_anchors(Middles(place, seen), sizes, share, distance=0.05).classes == (1, 2, 4)


def test_what_moves_in_a_dataset_is_followed_and_batches_say_where_it_is(dataset: MultiViewDataset):
    config = PretrainConfig("data", "out", scenes_per_step=3)
    statistics = measure(dataset, config)
    followed = [dataset.class_names[c] for c in statistics.anchors.classes]
    assert {"robot", "gripper", "drawer"} <= set(followed) and "background" not in followed
    batch = RayBatches(dataset, config, statistics)[0]
    assert batch.middles.shape == (3, len(followed), 3) and batch.seen.shape == (3, len(followed))
    frames = [
        int(np.flatnonzero((dataset.read("rgb")[:, dataset.views("encoder")] == i.numpy()).all((1, 2, 3, 4)))[0])
        for i in batch.images
    ]
    hand = dataset.read("state/privileged")[frames, :3]
    gripper = batch.middles[:, followed.index("gripper")].numpy()
    assert batch.seen[:, followed.index("gripper")].all()
    assert np.abs(gripper - hand).max() < 0.12  # the fingers are just below the hand
    assert np.abs(gripper - hand).max() > 1e-3  # and are not read from the state


def test_the_anchor_loss_alone_brings_frames_to_their_classes(dataset: MultiViewDataset):
    """It has a slope from anywhere: no ray is rendered here."""
    config = PretrainConfig("data", "out", scenes_per_step=8)
    data = MultiViewDataModule(dataset, config)
    torch.manual_seed(0)
    module = SnerlModule(config, dataset, data.statistics, data.rig)
    batch = RayBatches(dataset, config, data.statistics)[0]
    spread = module.anchor_spread[:, None]

    def error() -> torch.Tensor:
        origins = module.field.origins(module.encoder(batch.images, batch.projections))[:, : len(spread)]
        return (((origins - batch.middles) / spread) ** 2)[batch.seen].mean()

    optimiser = torch.optim.Adam(module.parameters(), lr=1e-3)
    before = error().item()
    for _ in range(80):
        optimiser.zero_grad()
        error().backward()
        optimiser.step()
    assert error().item() < 0.2 * before


def test_middles_that_are_kept_are_those_of_their_frames_however_they_were_drawn(tiny_dataset: Path):
    dataset = MultiViewDataset(tiny_dataset)
    classes = len(dataset.class_names)
    followed = (1, classes - 1)
    kept = FollowedMiddles(dataset, Anchors(followed, np.zeros((2, 3)), np.ones(2), np.ones(2), np.full(2, 0.1)))
    for drawn in ([4, 1, 4], [1, 0, 5], [5, 4, 2]):
        frames = np.array(drawn)
        intrinsics, poses = dataset.cameras(frames)
        seen = dataset.read("depth", frames), dataset.read_labels(frames), intrinsics, poses
        found, expected = kept.of(frames, *seen), visible_middles(*seen, classes)
        assert np.array_equal(found.seen, expected.seen[:, followed])
        assert np.allclose(found.place, expected.place[:, followed], atol=1e-6)


@pytest.mark.parametrize("object_plane_size", [0, 8])
def test_every_parameter_learns_once_and_at_its_rate(dataset: MultiViewDataset, object_plane_size: int):
    """The encoder's and the frames' is the recipe's, on which what a probe reads depends most."""
    field = FieldConfig(object_plane_size=object_plane_size)
    config = PretrainConfig("data", "out", learning_rate=1e-3, field_rate=3.0, radiance_field=field)
    data = MultiViewDataModule(dataset, config)
    module = SnerlModule(config, dataset, data.statistics, data.rig)
    groups = module.configure_optimizers()["optimizer"].param_groups
    rates = {id(parameter): group["initial_lr"] for group in groups for parameter in group["params"]}
    assert sum(len(group["params"]) for group in groups) == len(rates) == len(list(module.parameters()))
    told = {name: rates[id(parameter)] for name, parameter in module.named_parameters()}
    planes = {name for name in told if name.endswith("planes")}
    assert len(planes) == 1 + bool(object_plane_size) and all(told[name] == pytest.approx(1e-2) for name in planes)
    own = {name for name in told if name.startswith("encoder.") or "frame_origins" in name}
    assert all(told[name] == pytest.approx(1e-3) for name in own)
    rest = set(told) - planes - own
    assert {"field.rgb_head.weight", "field.layers.0.weight"} < rest
    assert all(told[name] == pytest.approx(3e-3) for name in rest)
