"""Figures of merit against brute force and closed forms."""

import math

import pytest

from nerf_rl import metrics


@pytest.mark.parametrize("error, decibels", [(1.0, 0.0), (0.1, 10.0), (0.01, 20.0), (1e-4, 40.0)])
def test_psnr_falls_by_ten_decibels_for_each_power_of_ten(error: float, decibels: float):
    assert metrics.psnr_db(error) == pytest.approx(decibels)


def test_identical_images_have_infinite_psnr():
    assert metrics.psnr_db(0.0) == math.inf


@pytest.mark.parametrize("successes, trials", [(1, 10), (5, 10), (19, 20), (300, 1000)])
def test_wilson_bounds_are_the_rates_that_a_score_test_just_rejects(successes: int, trials: int):
    """Wilson, "Probable inference, the law of succession, and statistical inference" (1927), equation 5."""
    rate = successes / trials
    within_deviations = math.erf(1.5 / math.sqrt(2))
    for bound in metrics.wilson_interval(successes, trials, within_deviations):
        score = abs(rate - bound) / math.sqrt(bound * (1 - bound) / trials)
        assert score == pytest.approx(1.5)


def test_wilson_interval_stays_in_range_at_the_extremes():
    assert metrics.wilson_interval(0, 20)[0] == 0.0
    assert metrics.wilson_interval(20, 20)[1] == pytest.approx(1.0)
    assert metrics.wilson_interval(0, 20)[1] == pytest.approx(1 - metrics.wilson_interval(20, 20)[0])
    assert metrics.wilson_interval(0, 0) == (0.0, 1.0)


def test_success_rates_of_before_keep_their_interval():
    """It was 1.96 deviations, rounded, on either side."""
    assert metrics.wilson_interval(17, 20) == pytest.approx((0.6395767, 0.9476322), abs=1e-5)
