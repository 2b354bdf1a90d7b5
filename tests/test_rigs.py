"""Camera rigs: order, roles, intrinsics and random poses."""

import numpy as np
import pytest

from nerf_rl.cameras import camera_position
from nerf_rl.datasets.config import CameraConfig, RandomCameraConfig, RigConfig
from nerf_rl.datasets.rigs import make_rig
from nerf_rl.errors import UserError


def named(*names: str) -> list[CameraConfig]:
    return [CameraConfig(name, azimuth=90.0 + 10 * i) for i, name in enumerate(names)]


def test_cameras_keep_their_order_and_random_ones_come_last():
    rig = make_rig(RigConfig(named("b", "a"), random=RandomCameraConfig(2)), 32)
    assert rig.names == ("b", "a", "random_0", "random_1")
    assert rig.roles == ("encoder", "encoder", "supervision", "supervision")
    assert rig.moving


def test_all_fixed_cameras_but_test_cameras_feed_the_encoder_unless_named():
    cameras = named("a", "b", "c")
    assert make_rig(RigConfig(cameras, test=["b"]), 32).roles == ("encoder", "test", "encoder")
    assert make_rig(RigConfig(cameras, encoder=["c"], test=["b"]), 32).roles == ("supervision", "test", "encoder")
    assert not make_rig(RigConfig(cameras), 32).moving


def test_fixed_poses_look_at_their_points_from_their_distance_and_stay():
    camera = CameraConfig("a", lookat=[0.1, 0.5, 0.2], distance=0.7, azimuth=33.0, elevation=-20.0, fovy=60.0)
    rig = make_rig(RigConfig([camera], random=RandomCameraConfig(1)), 40)
    rng = np.random.default_rng(0)
    first, second = rig.poses(rng), rig.poses(rng)
    np.testing.assert_array_equal(first[0], second[0])
    assert not np.allclose(first[1], second[1])
    np.testing.assert_allclose(first[0] @ [0.1, 0.5, 0.2, 1.0], [0, 0, 0.7, 1], atol=1e-12)
    edge = np.tan(np.deg2rad(30.0))  # at unit depth, half the field of view above the axis: the image's upper edge
    np.testing.assert_allclose(rig.intrinsics[0] @ [0, -edge, 1], [20, 0, 1], atol=1e-9)


def test_random_poses_lie_within_their_ranges_and_fill_them():
    ranges = RandomCameraConfig(
        50,
        lookat=[0.1, 0.6, 0.2],
        lookat_spread=0.0,
        distance=[0.5, 0.8],
        azimuth=[10.0, 60.0],
        elevation=[-70.0, -20.0],
    )
    poses = make_rig(RigConfig(named("a"), random=ranges), 32).poses(np.random.default_rng(0))[1:]
    towards = np.array(ranges.lookat) - camera_position(poses)
    distance = np.linalg.norm(towards, axis=1)
    azimuth = np.rad2deg(np.arctan2(towards[:, 1], towards[:, 0]))
    elevation = np.rad2deg(np.arcsin(towards[:, 2] / distance))
    for drawn, (low, high) in ((distance, (0.5, 0.8)), (azimuth, (10, 60)), (elevation, (-70, -20))):
        assert drawn.min() >= low - 1e-9 and drawn.max() <= high + 1e-9
        assert drawn.min() < low + 0.2 * (high - low) and drawn.max() > high - 0.2 * (high - low)


def test_points_that_random_cameras_look_at_lie_in_the_box():
    ranges = RandomCameraConfig(100, lookat=[0.0, 0.6, 0.1], lookat_spread=0.1, distance=[0.6, 0.6])
    poses = make_rig(RigConfig(named("a"), random=ranges), 32).poses(np.random.default_rng(1))[1:]
    offset = camera_position(poses) + 0.6 * poses[:, 2, :3] - np.array(ranges.lookat)
    assert np.abs(offset).max() <= 0.1 + 1e-9 and np.abs(offset).max(0).min() > 0.08


@pytest.mark.parametrize(
    "config, words",
    [
        (RigConfig(named("a", "b"), encoder=["c"]), "unknown encoder camera 'c'.*available: a, b"),
        (RigConfig(named("a", "b"), test=["lfet"]), "unknown test camera 'lfet'.*available: a, b"),
        (
            RigConfig(named("a"), encoder=["random_0"], random=RandomCameraConfig(1)),
            "unknown encoder camera 'random_0'",
        ),
        (RigConfig(named("a", "b"), encoder=["a"], test=["a"]), "'a' cannot be an encoder camera and a test camera"),
        (RigConfig(named("a", "a")), "camera names must differ: a, a"),
        (RigConfig(named("random_0"), random=RandomCameraConfig(1)), "camera names must differ: random_0, random_0"),
        (RigConfig([]), "at least one fixed camera for the encoder"),
        (RigConfig(named("a"), test=["a"]), "at least one fixed camera for the encoder"),
    ],
)
def test_contradictions_are_told_in_the_users_words(config: RigConfig, words: str):
    with pytest.raises(UserError, match=words):
        make_rig(config, 32)
