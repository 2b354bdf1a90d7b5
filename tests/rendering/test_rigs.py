"""Camera rigs: order, roles, intrinsics, fitted, mounted and random poses."""

import mujoco
import numpy as np
import pytest

from nerf_rl.cameras.geometry import camera_position, project, projection_matrix
from nerf_rl.cameras.rig_config import CameraConfig, DomeConfig, RandomCameraConfig, RigConfig, RingConfig
from nerf_rl.cameras.tracking_frame import TrackingFrame
from nerf_rl.errors import UserError
from nerf_rl.rendering.rigs import Rig, make_rig
from nerf_rl.scenes.base import Scene
from nerf_rl.scenes.make import make_scene


@pytest.fixture(scope="module")
def blocks() -> Scene:
    """An arm with blocks on a table, in the state after a reset."""
    scene = make_scene("datasets/scenes/blocks.xml")
    scene.env.reset(seed=1)
    return scene


def poses_of(rig: Rig, scene: Scene, seed: int = 0) -> np.ndarray:
    return rig.poses(scene.render_data(), np.random.default_rng(seed))


def named(*names: str) -> list[CameraConfig]:
    return [CameraConfig(name, azimuth=90.0 + 10 * i) for i, name in enumerate(names)]


def test_cameras_keep_their_order_and_random_ones_come_last(blocks: Scene):
    rig = make_rig(RigConfig(named("b", "a"), random=RandomCameraConfig(2)), 32, blocks)
    assert rig.names == ("b", "a", "random_0", "random_1")
    assert rig.roles == ("encoder", "encoder", "supervision", "supervision")
    assert rig.moving


def test_all_fixed_cameras_but_test_cameras_feed_the_encoder_unless_named(blocks: Scene):
    cameras = named("a", "b", "c")
    assert make_rig(RigConfig(cameras, test=["b"]), 32, blocks).roles == ("encoder", "test", "encoder")
    assert make_rig(RigConfig(cameras, encoder=["c"], test=["b"]), 32, blocks).roles == (
        "supervision",
        "test",
        "encoder",
    )
    assert not make_rig(RigConfig(cameras), 32, blocks).moving


def test_fixed_poses_look_at_their_points_from_their_distance_and_stay(blocks: Scene):
    camera = CameraConfig("a", lookat=[0.1, 0.5, 0.2], distance=0.7, azimuth=33.0, elevation=-20.0, fovy=60.0)
    rig = make_rig(RigConfig([camera], random=RandomCameraConfig(1)), 40, blocks)
    rng = np.random.default_rng(0)
    first, second = rig.poses(blocks.render_data(), rng), rig.poses(blocks.render_data(), rng)
    np.testing.assert_array_equal(first[0], second[0])
    assert not np.allclose(first[1], second[1])
    np.testing.assert_allclose(first[0] @ [0.1, 0.5, 0.2, 1.0], [0, 0, 0.7, 1], atol=1e-12)
    edge = np.tan(np.deg2rad(30.0))  # at unit depth, half the field of view above the axis: the image's upper edge
    np.testing.assert_allclose(rig.intrinsics[0] @ [0, -edge, 1], [20, 0, 1], atol=1e-9)


def test_random_poses_lie_within_their_ranges_and_fill_them(blocks: Scene):
    ranges = RandomCameraConfig(
        50,
        lookat=[0.1, 0.6, 0.2],
        lookat_spread=0.0,
        distance=[0.5, 0.8],
        azimuth=[10.0, 60.0],
        elevation=[-70.0, -20.0],
    )
    rig = make_rig(RigConfig(named("a"), random=ranges), 32, blocks)
    poses = rig.poses(blocks.render_data(), np.random.default_rng(0))[1:]
    towards = np.array(ranges.lookat) - camera_position(poses)
    distance = np.linalg.norm(towards, axis=1)
    azimuth = np.rad2deg(np.arctan2(towards[:, 1], towards[:, 0]))
    elevation = np.rad2deg(np.arcsin(towards[:, 2] / distance))
    for drawn, (low, high) in ((distance, (0.5, 0.8)), (azimuth, (10, 60)), (elevation, (-70, -20))):
        assert drawn.min() >= low - 1e-9 and drawn.max() <= high + 1e-9
        assert drawn.min() < low + 0.2 * (high - low) and drawn.max() > high - 0.2 * (high - low)


def test_points_that_random_cameras_look_at_lie_in_the_box(blocks: Scene):
    ranges = RandomCameraConfig(100, lookat=[0.0, 0.6, 0.1], lookat_spread=0.1, distance=[0.6, 0.6])
    rig = make_rig(RigConfig(named("a"), random=ranges), 32, blocks)
    poses = rig.poses(blocks.render_data(), np.random.default_rng(1))[1:]
    offset = camera_position(poses) + 0.6 * poses[:, 2, :3] - np.array(ranges.lookat)
    assert np.abs(offset).max() <= 0.1 + 1e-9 and np.abs(offset).max(0).min() > 0.08


@pytest.mark.parametrize("kind", [RingConfig, DomeConfig])
def test_rings_and_domes_have_names(kind: type[RingConfig] | type[DomeConfig]):
    with pytest.raises(UserError, match=r"(ring|dome) '' needs a name"):
        kind("")


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
        (RigConfig(named("a"), test=["a"]), "needs a camera for the encoder"),
        (RigConfig(named("a"), rings=[RingConfig("a")]), "two cameras, rings or domes are named 'a'"),
        (
            RigConfig([CameraConfig("a", camera="wirst")]),
            r"unknown camera of the model for 'a' 'wirst' \(did you mean wrist",
        ),
        (
            RigConfig([CameraConfig("a", body="hnad", distance=1.0)]),
            r"unknown body of camera 'a' 'hnad' \(did you mean hand",
        ),
        (RigConfig(random=RandomCameraConfig(1, follow="hnad")), "unknown body of random cameras 'hnad'"),
        (RigConfig(follow="hnad"), r"unknown body of rig.follow 'hnad' \(did you mean hand.*available: .*red_block"),
        (
            RigConfig([CameraConfig("a", position=[1.0, 0.0, 0.0], lookat=[1.0, 0.0, 0.0])]),
            "'a' looks at the point where it is",
        ),
    ],
)
def test_contradictions_are_told_in_the_users_words(config: RigConfig, words: str, blocks: Scene):
    with pytest.raises(UserError, match=words):
        make_rig(config, 32, blocks)


@pytest.mark.parametrize(
    "settings, words",
    [
        ({"camera": "wrist", "body": "hand"}, "can have one of camera, body and follow"),
        ({"body": "hand"}, "needs a position or a distance"),
        ({"lookat": [1.0, 2.0]}, "lookat needs 3 numbers, got 2"),
        ({"distance": -1.0}, "distance must not be negative"),
    ],
)
def test_settings_that_make_no_camera_are_refused(settings: dict, words: str):
    with pytest.raises(UserError, match=f"camera 'a'.*{words}"):
        CameraConfig("a", **settings)


def test_a_camera_without_a_name_is_refused():
    with pytest.raises(UserError, match="has an empty name; give it one"):
        CameraConfig("")


def test_rigs_follow_bodies_that_have_a_name():
    with pytest.raises(UserError, match="auto, none"):
        RigConfig(follow="")


def test_rings_are_spread_evenly_and_look_at_one_point_from_one_height(blocks: Scene):
    ring = RingConfig("around", count=4, azimuth=10.0, elevation=-25.0, lookat=[0.2, 0.1, 0.05], distance=0.8)
    rig = make_rig(RigConfig(rings=[ring]), 32, blocks)
    assert rig.names == ("around_0", "around_1", "around_2", "around_3") and not rig.moving
    poses = poses_of(rig, blocks)
    np.testing.assert_allclose(poses @ [0.2, 0.1, 0.05, 1], [[0, 0, 0.8, 1]] * 4, atol=1e-12)
    assert np.ptp(camera_position(poses)[:, 2]) < 1e-12
    heading = np.rad2deg(np.arctan2(poses[:, 2, 1], poses[:, 2, 0])) % 360
    np.testing.assert_allclose(heading, [10, 100, 190, 280])


def test_a_ring_over_a_part_of_the_circle_ends_at_its_span():
    headings = [camera.azimuth for camera in RingConfig(count=3, azimuth=20.0, span=140.0).cameras()]
    assert headings == [20.0, 90.0, 160.0]


def test_domes_cover_their_part_of_the_sphere_evenly(blocks: Scene):
    dome = DomeConfig(count=60, elevation=[-80.0, -20.0], lookat=[0.3, 0.0, 0.1], distance=1.0)
    poses = poses_of(make_rig(RigConfig(domes=[dome]), 32, blocks), blocks)
    outward = camera_position(poses) - [0.3, 0.0, 0.1]
    np.testing.assert_allclose(np.linalg.norm(outward, axis=1), 1.0)
    height = np.rad2deg(np.arcsin(outward[:, 2]))
    assert height.min() > 20 and height.max() < 80
    distances = np.linalg.norm(outward[:, None] - outward[None], axis=-1) + 10 * np.eye(60)
    nearest = distances.min(1)
    assert nearest.min() > 0.6 * nearest.mean()  # no two cameras in one place, no hole elsewhere


def test_a_role_given_to_a_ring_is_that_of_all_of_its_cameras(blocks: Scene):
    config = RigConfig(named("a"), [RingConfig("ring", 2)], [DomeConfig("dome", 2)], encoder=["ring"], test=["dome"])
    rig = make_rig(config, 32, blocks)
    assert rig.names == ("a", "ring_0", "ring_1", "dome_0", "dome_1")
    assert rig.roles == ("supervision", "encoder", "encoder", "test", "test")


def test_cameras_without_a_place_see_the_whole_workspace(blocks: Scene):
    rig = make_rig(RigConfig(rings=[RingConfig(count=5)], domes=[DomeConfig(count=5)]), 64, blocks)
    ball = blocks.workspace()
    surface = np.random.default_rng(0).standard_normal((500, 3))
    points = ball.centre + ball.radius * surface / np.linalg.norm(surface, axis=1, keepdims=True)
    for matrix in projection_matrix(rig.intrinsics, poses_of(rig, blocks)):
        pixels, depth = project(matrix, points)
        assert depth.min() > 0 and pixels.min() > -0.1 and pixels.max() < 64.1
        assert pixels.max() - pixels.min() > 55  # and it fills the image


def test_cameras_of_the_model_are_where_mujoco_has_them(blocks: Scene):
    rig = make_rig(RigConfig([CameraConfig("o", camera="overview"), CameraConfig("w", camera="wrist")]), 32, blocks)
    assert rig.moving
    data = blocks.render_data()
    poses = rig.poses(data, np.random.default_rng(0))
    for pose, name in zip(poses, ("overview", "wrist"), strict=True):
        camera = data.camera(name)
        np.testing.assert_allclose(camera_position(pose), camera.xpos, atol=1e-12)
        right, up, back = camera.xmat.reshape(3, 3).T
        np.testing.assert_allclose(pose[:3, :3], [right, -up, -back], atol=1e-12)
    assert rig.intrinsics[1, 0, 0] == pytest.approx(16 / np.tan(np.deg2rad(35)))


def test_a_camera_on_a_body_moves_and_turns_with_it_and_one_that_follows_only_moves(blocks: Scene):
    config = RigConfig(
        [
            CameraConfig("still", lookat=[0.2, 0.0, 0.1]),
            CameraConfig("on", body="hand", position=[0.2, 0.0, -0.1], lookat=[0.0, 0.0, 0.05]),
            CameraConfig("behind", follow="hand", distance=0.5),
        ]
    )
    rig = make_rig(config, 32, blocks)
    seen = []
    for angle in (0.0, 0.7):
        blocks.data.joint("yaw").qpos[0] = angle
        data = blocks.render_data()
        hand = data.body("hand")
        poses = rig.poses(data, np.random.default_rng(0))
        mounted = hand.xpos + hand.xmat.reshape(3, 3) @ [0.2, 0.0, -0.1]
        np.testing.assert_allclose(camera_position(poses[1]), mounted, atol=1e-12)
        target = hand.xpos + hand.xmat.reshape(3, 3) @ [0.0, 0.0, 0.05]
        np.testing.assert_allclose((poses[1] @ [*target, 1])[:2], 0.0, atol=1e-12)
        np.testing.assert_allclose(poses[2] @ [*hand.xpos, 1], [0, 0, 0.5, 1], atol=1e-12)
        seen.append(poses)
    before, after = seen
    np.testing.assert_array_equal(before[0], after[0])
    assert not np.allclose(before[1, :3, :3], after[1, :3, :3])
    np.testing.assert_array_equal(before[2, :3, :3], after[2, :3, :3])
    assert not np.allclose(before[2], after[2])


@pytest.fixture(scope="module")
def ant() -> Scene:
    return make_scene("gym/Ant-v5")


def test_what_can_leave_is_followed_by_default(ant: Scene):
    rig = make_rig(RigConfig(random=RandomCameraConfig(2)), 32, ant)
    assert rig.tracking_frame == TrackingFrame("torso", "xy")
    for seed in range(2):
        ant.env.reset(seed=seed)
        ant.data.qpos[:2] = [3.0 * seed, -2.0]
        shown = ant.render_data()
        torso = np.tile(shown.body("torso").xpos, (5, 1, 1))
        pixels, depth = project(projection_matrix(rig.intrinsics, poses_of(rig, ant)), torso)
        assert depth.min() > 0 and np.abs(pixels - 16).max() < 12


def moved(rig: Rig, scene: Scene, to: list[float]) -> tuple[np.ndarray, np.ndarray]:
    """Return where the cameras and the tracking frame have gone when the robot's root goes somewhere."""
    scene.env.reset(seed=0)
    places = []
    for position in ([0.0, 0.0, 0.75], to):
        scene.data.qpos[:3] = position
        shown = scene.render_data()
        places.append((camera_position(rig.poses(shown, np.random.default_rng(0))), rig.origin(shown)))
    (before, first), (after, then) = places
    return after - before, then - first


@pytest.mark.parametrize(
    "config, way",
    [
        (RigConfig(), [3.0, -2.0, 0.0]),
        (RigConfig(follow_axes="xyz"), [3.0, -2.0, 0.5]),
        (RigConfig([CameraConfig("a", follow="torso"), CameraConfig("b")]), [3.0, -2.0, 0.0]),
        (RigConfig(follow="none"), [0.0, 0.0, 0.0]),
        (RigConfig([CameraConfig("a", lookat=[0.0, 0.0, 0.5])]), [0.0, 0.0, 0.0]),
    ],
)
def test_cameras_follow_along_the_axes_asked_for_and_their_frame_with_them(config: RigConfig, way: list, ant: Scene):
    rig = make_rig(config, 32, ant)
    cameras, frame = moved(rig, ant, [3.0, -2.0, 1.25])
    np.testing.assert_allclose(cameras, np.tile(way, (len(cameras), 1)), atol=1e-12)
    np.testing.assert_allclose(frame, way, atol=1e-12)
    assert (rig.tracking_frame is None) == (not any(way))


def test_any_body_can_be_followed(blocks: Scene):
    """Its cameras look where they would without, as long as it stays where it is."""
    still, following = (make_rig(RigConfig(follow=body), 32, blocks) for body in ("auto", "hand"))
    assert still.tracking_frame is None and following.tracking_frame == TrackingFrame("hand", "xy")
    np.testing.assert_allclose(poses_of(following, blocks), poses_of(still, blocks), atol=1e-12)


def test_cameras_that_follow_different_bodies_have_no_frame_in_common(blocks: Scene):
    cameras = [CameraConfig("a", follow="hand"), CameraConfig("b", follow="red_block"), CameraConfig("c")]
    assert make_rig(RigConfig(cameras), 32, blocks).tracking_frame is None
    one = make_rig(RigConfig(cameras, encoder=["a"]), 32, blocks)
    assert one.tracking_frame == TrackingFrame("hand")  # the others only supervise


def test_a_model_camera_that_is_no_pinhole_by_its_angle_is_refused(tmp_path):
    path = tmp_path / "lens.xml"
    camera = '<camera name="lens" pos="0 0 2" sensorsize="0.01 0.01" focal="0.02 0.02" resolution="64 64"/>'
    path.write_text(f"<mujoco><worldbody>{camera}<geom size='1'/></worldbody></mujoco>")
    assert mujoco.MjModel.from_xml_path(str(path)).ncam == 1
    with pytest.raises(UserError, match="camera 'lens' of the model is not a pinhole given by its fovy"):
        make_rig(RigConfig([CameraConfig("a", camera="lens")]), 32, make_scene(str(path)))
