"""Feature teachers on surfaces whose normals are known."""

import json
from pathlib import Path

import numpy as np
import pytest

from nerf_rl import cli
from nerf_rl.cameras import geometry as cameras
from nerf_rl.datasets.storage.reader import MultiViewDataset
from nerf_rl.errors import UserError
from nerf_rl.pretrain.config import PretrainConfig
from nerf_rl.pretrain.data.batches import RayBatches
from nerf_rl.pretrain.data.statistics import measure
from nerf_rl.pretrain.data.teachers import TEACHERS, Pixels, Views, find_teacher, surface_normals, teacher_features

SIZE, FAR = 40, 5.0


def some_cameras(count: int) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(0)
    poses = [
        cameras.look_at(rng.uniform(-0.1, 0.1, 3), 1.0, rng.uniform(-180, 180), rng.uniform(-80, -50))
        for _ in range(count)
    ]
    return np.stack([cameras.intrinsics_from_fovy(40.0, SIZE, SIZE)] * count), np.stack(poses)


def rays(intrinsics: np.ndarray, poses: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return origins [V, 1, 3] and directions of unit planar depth [V, H * W, 3]."""
    pixels = np.broadcast_to(cameras.pixel_centres(SIZE, SIZE), (len(poses), SIZE * SIZE, 2))
    return cameras.camera_position(poses)[:, None], cameras.pixel_directions(intrinsics, poses, pixels)


def plane_depth(intrinsics: np.ndarray, poses: np.ndarray, normal: np.ndarray) -> np.ndarray:
    """Return depth images of the plane through the origin."""
    origins, directions = rays(intrinsics, poses)
    return (-(origins @ normal) / (directions @ normal)).reshape(-1, SIZE, SIZE)


def seen(depth: np.ndarray, intrinsics: np.ndarray, poses: np.ndarray) -> Views:
    """Return views of a grey scene of one class."""
    rgb = np.full((*depth.shape, 3), 128, np.uint8)
    return Views(rgb, depth, np.zeros(depth.shape, np.uint8), intrinsics, poses, FAR)


def every_pixel(images: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    image, row, column = np.mgrid[:images, :SIZE, :SIZE]
    return image.ravel(), row.ravel(), column.ravel()


def test_normals_of_a_plane_are_the_planes_and_point_to_the_camera():
    intrinsics, poses = some_cameras(5)
    for normal in (np.array([0.0, 0.0, 1.0]), np.array([0.2, -0.1, 0.97]) / np.linalg.norm([0.2, -0.1, 0.97])):
        depth = plane_depth(intrinsics, poses, normal)
        assert depth.min() > 0 and depth.max() < FAR
        found = surface_normals(depth, intrinsics, poses, *every_pixel(5), FAR)
        np.testing.assert_allclose(found, np.broadcast_to(normal, found.shape), atol=1e-6)


def test_normals_of_a_sphere_are_its_radii():
    intrinsics, poses = some_cameras(3)
    origins, directions = rays(intrinsics, poses)
    a, b = (directions**2).sum(-1), (directions * origins).sum(-1)
    discriminant = b**2 - a * ((origins**2).sum(-1) - 0.25**2)
    hit = discriminant > 0
    depth = np.where(hit, (-b - np.sqrt(np.maximum(discriminant, 0))) / a, 2 * FAR)
    image, row, column = every_pixel(3)
    found = surface_normals(depth.reshape(3, SIZE, SIZE), intrinsics, poses, image, row, column, FAR).reshape(3, -1, 3)
    radii = (origins + depth[..., None] * directions) / 0.25
    facing = hit & ((radii * -directions).sum(-1) > 0.5 * np.linalg.norm(directions, axis=-1))  # not at the rim
    assert facing.sum() > 300
    angles = np.rad2deg(np.arccos(np.clip((found * radii).sum(-1)[facing], -1, 1)))
    assert angles.max() < 10 and angles.mean() < 4
    np.testing.assert_array_equal(found[~hit], 0.0)
    np.testing.assert_allclose(np.linalg.norm(found[hit], axis=-1), 1.0)


def test_normals_beside_an_outline_belong_to_their_own_surface():
    pose = cameras.look_at(np.zeros(3), 1.0, 90.0, -89.9)  # looks straight down
    intrinsics = cameras.intrinsics_from_fovy(40.0, SIZE, SIZE)
    depth = np.full((1, SIZE, SIZE), 1.0)
    depth[:, 10:20, 15:30] = 0.6  # the flat top of a box
    found = surface_normals(depth, intrinsics[None], pose[None], *every_pixel(1), FAR)
    np.testing.assert_allclose(found, np.broadcast_to(-pose[2, :3], found.shape), atol=1e-6)


def test_features_are_the_teachers_in_their_order():
    intrinsics, poses = some_cameras(2)
    depth = plane_depth(intrinsics, poses, np.array([0.0, 0.0, 1.0]))
    depth[1, 3, 4] = 30.0
    pixels = Pixels(np.array([0, 1, 1]), np.array([7, 3, 20]), np.array([9, 4, 30]))
    features = {
        name: teacher_features(names, seen(depth, intrinsics, poses), pixels)
        for name, names in {
            "d": ["depth"],
            "n": ["normals"],
            "dn": ["depth", "normals"],
            "nd": ["normals", "depth"],
        }.items()
    }
    np.testing.assert_allclose(features["d"][:, 0], [depth[0, 7, 9] / FAR, 1.0, depth[1, 20, 30] / FAR], rtol=1e-6)
    np.testing.assert_array_equal(features["n"][1], 0.0)
    np.testing.assert_array_equal(features["dn"], np.concatenate([features["d"], features["n"]], axis=1))
    np.testing.assert_array_equal(features["nd"], np.concatenate([features["n"], features["d"]], axis=1))


@pytest.mark.parametrize("name", TEACHERS)
def test_a_teacher_is_as_wide_as_it_says(name: str):
    intrinsics, poses = some_cameras(1)
    depth = plane_depth(intrinsics, poses, np.array([0.0, 0.0, 1.0]))
    zero = np.zeros(2, int)
    features = teacher_features([name], seen(depth, intrinsics, poses), Pixels(zero, zero, zero))
    assert features.shape == (2, find_teacher(name).width)


OWN = """
import numpy as np


class Brightness:
    width = 2

    def features(self, views, pixels):
        brightness = views.rgb[tuple(pixels)].mean(-1) / 255
        return np.stack([brightness, views.semantic[tuple(pixels)] > 0], axis=1)


class Narrow:
    width = 0


class Long:
    width = 2

    def features(self, views, pixels):
        return np.zeros((len(pixels.image), 1))


def broken():
    raise RuntimeError("no weights")
"""


def test_a_teacher_of_ones_own_stands_in_a_file_outside_the_package(
    tiny_dataset: Path, tiny_pretraining_recipe: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    """It sees colours and labels, and the field learns as many features as it says."""
    (tmp_path / "own_teacher.py").write_text(OWN)
    monkeypatch.syspath_prepend(str(tmp_path))
    words = ["--config", str(tiny_pretraining_recipe), "--data", str(tiny_dataset), "--out", str(tmp_path / "run")]
    words += ["--teachers", "[own_teacher:Brightness, depth]"]
    assert cli.main(["pretrain", *words]) == 0
    assert json.loads((tmp_path / "run" / "field.json").read_text())["teacher_features"] == 3
    dataset, config = MultiViewDataset(tiny_dataset), cli.parse("pretrain", words)
    batch = RayBatches(dataset, config, measure(dataset, config))[0]
    np.testing.assert_allclose(batch.feature[..., 0], batch.rgb.mean(-1), atol=1e-6)
    np.testing.assert_array_equal(batch.feature[..., 1], batch.semantic > 0)


def test_features_of_another_width_than_a_teacher_says_are_told(
    tiny_dataset: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    (tmp_path / "own_teacher.py").write_text(OWN)
    monkeypatch.syspath_prepend(str(tmp_path))
    dataset = MultiViewDataset(tiny_dataset)
    config = PretrainConfig("d", "o", teachers=["own_teacher:Long"], scenes_per_step=2, rays_per_scene=8)
    with pytest.raises(UserError, match=r"'own_teacher:Long' gave features \(16, 1\) where \(16, 2\) were due"):
        RayBatches(dataset, config, measure(dataset, config))[0]


@pytest.mark.parametrize(
    "name, reason",
    [
        ("nowhere:Teacher", "ModuleNotFoundError: No module named 'nowhere'"),
        ("own_teacher:Absent", "AttributeError: module 'own_teacher' has no attribute 'Absent'"),
        ("own_teacher:Narrow", "it needs a positive width and a method features"),
        ("own_teacher:broken", "RuntimeError: no weights"),
    ],
)
def test_a_teacher_that_cannot_be_had_is_told_before_anything_is_written(
    name: str,
    reason: str,
    tiny_dataset: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
):
    (tmp_path / "own_teacher.py").write_text(OWN)
    monkeypatch.syspath_prepend(str(tmp_path))
    words = ["--data", str(tiny_dataset), "--out", str(tmp_path / "run"), "--teachers", f"[{name}]"]
    assert cli.main(["pretrain", *words]) == 2
    message = capsys.readouterr().err
    assert name in message and reason in message and message.count("\n") == 1
    assert not (tmp_path / "run").exists()
