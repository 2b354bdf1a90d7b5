"""Figures of merit of single numbers; what compares pictures is torchmetrics'."""

import math


def psnr_db(mean_squared_error: float) -> float:
    """Return the peak signal-to-noise ratio [dB] of colours in [0, 1]; infinite for identical images."""
    return math.inf if mean_squared_error == 0 else -10.0 * math.log10(mean_squared_error)


def wilson_interval(successes: int, trials: int, confidence: float = 0.95) -> tuple[float, float]:
    """Return the Wilson score interval of a success rate, which stays sensible at 0 % and 100 %."""
    from scipy.stats import binomtest  # a second or two to import, which only evaluations spend

    if trials == 0:
        return 0.0, 1.0
    interval = binomtest(successes, trials).proportion_ci(confidence, method="wilson")
    return float(interval.low), float(interval.high)
