"""Figures of merit against brute force and closed forms."""

import math

import numpy as np
import pytest

from nerf_rl import metrics


@pytest.mark.parametrize("error, decibels", [(1.0, 0.0), (0.1, 10.0), (0.01, 20.0), (1e-4, 40.0)])
def test_psnr_falls_by_ten_decibels_for_each_power_of_ten(error: float, decibels: float):
    assert metrics.psnr_db(error) == pytest.approx(decibels)


def test_identical_images_have_infinite_psnr():
    assert metrics.psnr_db(0.0) == math.inf


@pytest.mark.parametrize("kind", [np.uint8, np.int64])
def test_confusion_matrix_is_a_count_of_pairs(kind: type):
    rng = np.random.default_rng(0)
    truth, predicted = rng.integers(0, 20, (2, 500)).astype(kind)
    expected = np.zeros((20, 20), dtype=np.int64)
    for pair in zip(truth, predicted, strict=True):
        expected[pair] += 1
    np.testing.assert_array_equal(metrics.confusion_matrix(truth, predicted, 20), expected)


def test_confusion_matrices_of_batches_add_up():
    truth, predicted = np.random.default_rng(1).integers(0, 4, (2, 300))
    parts = [metrics.confusion_matrix(truth[i : i + 100], predicted[i : i + 100], 4) for i in (0, 100, 200)]
    np.testing.assert_array_equal(sum(parts), metrics.confusion_matrix(truth, predicted, 4))


def test_intersection_over_union_is_that_of_pixel_sets():
    truth, predicted = np.random.default_rng(2).integers(0, 4, (2, 200))
    found = metrics.intersection_over_union(metrics.confusion_matrix(truth, predicted, 4))
    for label in range(4):
        pixels_true, pixels_found = set(np.flatnonzero(truth == label)), set(np.flatnonzero(predicted == label))
        assert found[label] == pytest.approx(len(pixels_true & pixels_found) / len(pixels_true | pixels_found))


def test_a_class_that_never_occurs_has_no_intersection_over_union():
    found = metrics.intersection_over_union(np.array([[3, 1, 0], [0, 4, 0], [0, 0, 0]]))
    np.testing.assert_allclose(found, [3 / 4, 4 / 5, np.nan])


@pytest.mark.parametrize("successes, trials", [(1, 10), (5, 10), (19, 20), (300, 1000)])
def test_wilson_bounds_are_the_rates_that_a_score_test_just_rejects(successes: int, trials: int):
    rate = successes / trials
    for bound in metrics.wilson_interval(successes, trials, z=1.5):
        score = abs(rate - bound) / math.sqrt(bound * (1 - bound) / trials)
        assert score == pytest.approx(1.5)


def test_wilson_interval_stays_in_range_at_the_extremes():
    assert metrics.wilson_interval(0, 20)[0] == 0.0
    assert metrics.wilson_interval(20, 20)[1] == pytest.approx(1.0)
    assert metrics.wilson_interval(0, 20)[1] == pytest.approx(1 - metrics.wilson_interval(20, 20)[0])
    assert metrics.wilson_interval(0, 0) == (0.0, 1.0)
