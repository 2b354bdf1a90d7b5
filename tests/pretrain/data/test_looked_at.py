"""How far off a scene is whose depth nobody knows, from where its cameras look."""

import numpy as np
import pytest

from nerf_rl.cameras.geometry import look_at, look_from
from nerf_rl.errors import UserError
from nerf_rl.pretrain.data.looked_at import distances_to_what_is_looked_at


def test_cameras_around_a_point_are_as_far_from_it_as_they_were_placed():
    point, distances = np.array([0.2, -0.1, 0.3]), np.array([0.8, 1.1, 1.7])
    poses = [look_at(point, d, azimuth, -30.0) for d, azimuth in zip(distances, (0.0, 110.0, 200.0), strict=True)]
    found = distances_to_what_is_looked_at(np.stack([poses, poses[::-1]]))
    np.testing.assert_allclose(found, [distances, distances[::-1]])


def test_axes_that_hardly_miss_each_other_meet_in_between():
    rng = np.random.default_rng(0)
    eyes = np.array([[1.0, 0, 0.5], [0, 1.0, 0.5], [-1.0, 0, 0.5], [0, -1.0, 0.5]])
    poses = np.stack([look_from(eye, 0.02 * rng.standard_normal(3)) for eye in eyes])
    found = distances_to_what_is_looked_at(poses[None])[0]
    np.testing.assert_allclose(found, np.sqrt(1.25), atol=0.06)


@pytest.mark.parametrize(
    "poses, fault",
    [
        ([look_from(np.array([1.0, 0, 0]), np.zeros(3))], "look in one direction"),
        ([look_from(np.array([1.0, y, 0]), np.array([0, y, 0])) for y in (0.0, 0.5)], "look in one direction"),
        ([look_from(np.array(p), 2 * np.array(p)) for p in ([1.0, 0, 0], [0, 1.0, 0])], "do not look at one point"),
    ],
)
def test_cameras_that_look_at_no_point_need_the_limits_said(poses: list[np.ndarray], fault: str):
    with pytest.raises(UserError, match=f"{fault}.*--sampling.near and --sampling.far"):
        distances_to_what_is_looked_at(np.stack(poses)[None])
