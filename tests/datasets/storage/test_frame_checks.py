"""Frames that show nothing are told from those that merely look plain."""

import numpy as np
import pytest

from nerf_rl.datasets.storage.frame_checks import array_faults, view_faults

SIZE = 5


def views(count: int = 3) -> tuple[np.ndarray, np.ndarray]:
    """Return pictures and depths with something in them."""
    rng = np.random.default_rng(0)
    return rng.integers(0, 256, (count, SIZE, SIZE, 3), np.uint8), rng.uniform(1, 2, (count, SIZE, SIZE)).astype("f4")


def test_pictures_with_something_in_them_are_fine():
    assert list(view_faults(*views())) == []


@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_a_depth_that_is_not_finite_is_found_where_it_is(value: float):
    rgb, depth = views()
    depth[1, 2, 3] = value
    assert list(view_faults(rgb, depth)) == [((1,), "has a depth that is not finite")]


def test_a_black_picture_shows_nothing_whatever_its_depth():
    rgb, depth = views()
    rgb[2] = 0
    assert list(view_faults(rgb, depth)) == [((2,), "sees nothing: its picture is black")]


def test_a_picture_of_one_colour_shows_nothing_unless_its_depth_does():
    rgb, depth = views()
    rgb[0] = (90, 90, 80)  # a wall, seen at an angle
    assert list(view_faults(rgb, depth)) == []
    depth[0] = 3.0
    assert list(view_faults(rgb, depth)) == [((0,), "sees nothing: its picture is of one colour at one depth")]


def test_many_frames_are_judged_at_once():
    rgb, depth = (np.stack([array] * 4) for array in views())
    rgb[3, 1] = 0
    depth[2, 0, 0, 0] = np.nan
    assert [index for index, _ in view_faults(rgb, depth)] == [(2, 0), (3, 1)]


def test_numbers_that_are_not_finite_are_found_and_whole_numbers_always_are():
    assert list(array_faults(np.array([1.0, np.nan]))) == ["is not finite"]
    assert list(array_faults(np.array([1.0, 2.0]))) == list(array_faults(np.array([1, 2]))) == []
