"""Figures of merit, as pure functions over NumPy arrays."""

import math

import numpy as np
from jaxtyping import Float, Int, Integer
from numpy import ndarray


def psnr_db(mean_squared_error: float) -> float:
    """Return the peak signal-to-noise ratio [dB] of colours in [0, 1]; infinite for identical images."""
    return math.inf if mean_squared_error == 0 else -10.0 * math.log10(mean_squared_error)


def confusion_matrix(
    truth: Integer[ndarray, "*N"], predicted: Integer[ndarray, "*N"], classes: int
) -> Int[ndarray, "classes classes"]:
    """Count pixels by (true class, predicted class); matrices of several batches add up."""
    index = truth.astype(np.int64).ravel() * classes + predicted.ravel()
    return np.bincount(index, minlength=classes * classes).reshape(classes, classes)


def intersection_over_union(confusion: Int[ndarray, "classes classes"]) -> Float[ndarray, "classes"]:
    """Return the IoU of each class; NaN where a class occurs neither in the truth nor in the prediction."""
    hits = np.diag(confusion).astype(np.float64)
    union = confusion.sum(0) + confusion.sum(1) - hits
    return np.divide(hits, union, out=np.full_like(hits, np.nan), where=union > 0)


def wilson_interval(successes: int, trials: int, z: float = 1.96) -> tuple[float, float]:
    """Return the Wilson score interval of a success rate (95 % by default), which stays sensible at 0 % and 100 %.

    Wilson, "Probable inference, the law of succession, and statistical inference" (1927), equation 5.
    """
    if trials == 0:
        return 0.0, 1.0
    rate = successes / trials
    centre = rate + z * z / (2 * trials)
    spread = z * math.sqrt(rate * (1 - rate) / trials + z * z / (4 * trials * trials))
    scale = 1 + z * z / trials
    return max(0.0, (centre - spread) / scale), min(1.0, (centre + spread) / scale)
