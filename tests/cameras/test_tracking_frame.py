"""Frames that travel: what is seen is the same in them as in the world."""

import numpy as np

from nerf_rl.cameras.geometry import intrinsics_from_fovy, look_at, project, projection_matrix
from nerf_rl.cameras.tracking_frame import TrackingFrame, to_tracking_frame, to_world


def test_a_point_is_in_the_same_pixel_in_the_frame_and_in_the_world():
    rng = np.random.default_rng(0)
    poses = np.stack([look_at(np.array([9.0, -4.0, 0.5]), 2.0, azimuth, -30.0) for azimuth in (20.0, 160.0)])
    points = np.array([9.0, -4.0, 0.5]) + rng.uniform(-0.5, 0.5, (3, 2, 7, 3))
    origins = rng.uniform(-9, 9, (3, 3))
    inside = to_tracking_frame(poses[None], origins[:, None])
    assert inside.shape == (3, 2, 4, 4)
    K = np.tile(intrinsics_from_fovy(45.0, 32, 32), (3, 2, 1, 1))
    world = np.tile(poses, (3, 1, 1, 1))
    seen = project(projection_matrix(K, inside), points - origins[:, None, None])
    for mine, theirs in zip(seen, project(projection_matrix(K, world), points), strict=True):
        np.testing.assert_allclose(mine, theirs, rtol=1e-9)
    np.testing.assert_allclose(to_world(inside, origins[:, None]), world, atol=1e-12)


def test_the_origin_goes_along_the_axes_that_are_followed():
    position = np.array([[1.0, 2.0, 3.0], [4.0, 5.0, 6.0]])
    np.testing.assert_array_equal(TrackingFrame("torso").origin(position), [[1, 2, 0], [4, 5, 0]])
    np.testing.assert_array_equal(TrackingFrame("torso", "xyz").origin(position), position)


def test_a_stored_frame_is_the_same_frame():
    frame = TrackingFrame("torso", "xyz")
    assert TrackingFrame.from_json(frame.to_json()) == frame and TrackingFrame.from_json(None) is None
