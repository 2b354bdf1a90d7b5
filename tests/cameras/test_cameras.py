"""Laws of the camera functions, each by a second route."""

import mujoco
import numpy as np
import pytest

from nerf_rl.cameras import geometry as cameras


def random_cameras(seed: int, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Return intrinsics [count, 3, 3] and camera_from_world [count, 4, 4] of cameras that look at the origin."""
    rng = np.random.default_rng(seed)
    intrinsics = np.stack([cameras.intrinsics_from_fovy(rng.uniform(20, 90), 48, 64) for _ in range(count)])
    poses = [
        cameras.look_at(rng.normal(size=3), rng.uniform(0.5, 2), rng.uniform(-180, 180), rng.uniform(-80, 80))
        for _ in range(count)
    ]
    return intrinsics, np.stack(poses)


def test_unprojecting_a_projected_point_gives_the_point_back():
    rng = np.random.default_rng(0)
    intrinsics, poses = random_cameras(1, 5)
    points = rng.normal(size=(5, 7, 3))
    pixels, depth = cameras.project(cameras.projection_matrix(intrinsics, poses), points)
    directions = cameras.pixel_directions(intrinsics, poses, pixels)
    again = cameras.camera_position(poses)[:, None] + depth[..., None] * directions
    np.testing.assert_allclose(again, points, atol=1e-9)


def test_projecting_an_unprojected_pixel_gives_the_pixel_and_its_depth_back():
    rng = np.random.default_rng(2)
    intrinsics, poses = random_cameras(3, 4)
    pixels, depth = rng.uniform(0, 64, size=(4, 9, 2)), rng.uniform(0.1, 3, size=(4, 9))
    directions = cameras.pixel_directions(intrinsics, poses, pixels)
    points = cameras.camera_position(poses)[:, None] + depth[..., None] * directions
    pixels_again, depth_again = cameras.project(cameras.projection_matrix(intrinsics, poses), points)
    np.testing.assert_allclose(pixels_again, pixels, atol=1e-7)
    np.testing.assert_allclose(depth_again, depth, atol=1e-9)


def test_leading_dimensions_are_the_same_as_a_loop():
    intrinsics, poses = random_cameras(4, 6)
    points = np.random.default_rng(5).normal(size=(2, 3, 8, 3))
    projections = cameras.projection_matrix(intrinsics, poses).reshape(2, 3, 3, 4)
    pixels, depth = cameras.project(projections, points)
    for index in np.ndindex(2, 3):
        pixels_here, depth_here = cameras.project(projections[index], points[index])
        np.testing.assert_allclose(pixels[index], pixels_here)
        np.testing.assert_allclose(depth[index], depth_here)


def test_projection_is_intrinsics_times_rotation_and_translation():
    intrinsics, poses = random_cameras(6, 1)
    rotation, translation = poses[0, :3, :3], poses[0, :3, 3]
    projection = cameras.projection_matrix(intrinsics[0], poses[0])
    for point in np.random.default_rng(7).normal(size=(5, 3)):
        x, y, z = intrinsics[0] @ (rotation @ point + translation)
        np.testing.assert_allclose(projection @ [*point, 1.0], [x, y, z])
        pixels, depth = cameras.project(projection, point[None])
        np.testing.assert_allclose(pixels[0], [x / z, y / z])
        np.testing.assert_allclose(depth[0], z)


def test_a_pose_is_a_proper_rigid_motion():
    _, poses = random_cameras(8, 20)
    rotation = poses[:, :3, :3]
    np.testing.assert_allclose(rotation @ rotation.swapaxes(1, 2), np.broadcast_to(np.eye(3), (20, 3, 3)), atol=1e-12)
    np.testing.assert_allclose(np.linalg.det(rotation), 1.0)
    np.testing.assert_array_equal(poses[:, 3], np.tile([0.0, 0.0, 0.0, 1.0], (20, 1)))
    np.testing.assert_allclose(cameras.camera_position(poses), np.linalg.inv(poses)[:, :3, 3], atol=1e-12)


def test_the_point_looked_at_is_in_the_image_centre_at_its_distance():
    lookat = np.array([0.1, 0.7, 0.2])
    pose = cameras.look_at(lookat, 0.9, 25.0, -40.0)
    pixels, depth = cameras.project(
        cameras.projection_matrix(cameras.intrinsics_from_fovy(45.0, 48, 64), pose), lookat[None]
    )
    np.testing.assert_allclose(pixels[0], [32.0, 24.0])
    np.testing.assert_allclose(depth[0], 0.9)


@pytest.mark.parametrize(
    "azimuth_deg, elevation_deg", [(0.0, 0.0), (90.0, -30.0), (160.0, -30.0), (-135.0, 60.0), (20.0, -89.0)]
)
def test_azimuth_and_elevation_are_those_of_mujocos_free_camera(azimuth_deg: float, elevation_deg: float):
    model = mujoco.MjModel.from_xml_string("<mujoco><worldbody><geom size='1'/></worldbody></mujoco>")
    camera = mujoco.MjvCamera()
    camera.type = mujoco.mjtCamera.mjCAMERA_FREE
    camera.lookat[:] = [0.1, 0.7, 0.2]
    camera.distance, camera.azimuth, camera.elevation = 0.9, azimuth_deg, elevation_deg
    scene = mujoco.MjvScene(model, maxgeom=1)
    mujoco.mjv_updateCamera(model, mujoco.MjData(model), camera, scene)
    left, right = scene.camera  # the two eyes

    pose = cameras.look_at(camera.lookat.copy(), 0.9, azimuth_deg, elevation_deg)
    np.testing.assert_allclose(cameras.camera_position(pose), (left.pos + right.pos) / 2, atol=1e-6)
    np.testing.assert_allclose(pose[2, :3], left.forward, atol=1e-6)
    np.testing.assert_allclose(pose[1, :3], -left.up, atol=1e-6)


def test_image_x_grows_to_the_right_and_y_downwards_and_what_is_behind_has_negative_depth():
    pose = cameras.look_at(np.zeros(3), 1.0, 0.0, 0.0)  # at x = -1 m, looking along +x, world z is up
    projection = cameras.projection_matrix(cameras.intrinsics_from_fovy(45.0, 48, 64), pose)
    pixels, depth = cameras.project(projection, np.array([[0, -0.1, 0], [0, 0, 0.1], [-2.0, 0, 0]]))
    assert pixels[0, 0] > 32  # -y is on the right of someone who looks along +x
    assert pixels[1, 1] < 24
    assert depth[2] == pytest.approx(-1.0)


def test_the_vertical_field_of_view_spans_the_image_height():
    pose = cameras.look_at(np.zeros(3), 2.0, 0.0, 0.0)
    projection = cameras.projection_matrix(cameras.intrinsics_from_fovy(50.0, 48, 64), pose)
    edge = 2.0 * np.tan(np.deg2rad(25.0))
    pixels, _ = cameras.project(projection, np.array([[0, 0, edge], [0, 0, -edge]]))
    np.testing.assert_allclose(pixels[:, 1], [0.0, 48.0], atol=1e-9)


def test_ray_directions_advance_one_metre_of_planar_depth():
    intrinsics, poses = random_cameras(9, 3)
    pixels = np.broadcast_to(cameras.pixel_centres(4, 5), (3, 20, 2))
    directions = cameras.pixel_directions(intrinsics, poses, pixels)
    along_axis = np.einsum("bnk,bk->bn", directions, poses[:, 2, :3])
    np.testing.assert_allclose(along_axis, 1.0)


def test_pixel_centres_are_in_row_major_order():
    centres = cameras.pixel_centres(3, 4)
    expected = [(column + 0.5, row + 0.5) for row in range(3) for column in range(4)]
    np.testing.assert_array_equal(centres, expected)
