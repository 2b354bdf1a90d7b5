"""Many runs in one number with an interval, as Agarwal et al. define it.

"Deep Reinforcement Learning at the Edge of the Statistical Precipice" (2021), whose library rliable is no longer
maintained. Scores are [N, M]: those of N runs (seeds) on each of M tasks.
"""

from collections.abc import Callable
from typing import Any

import numpy as np
from jaxtyping import Float
from numpy import ndarray

REPETITIONS = 10_000
_TRIMMED = 0.25  # share of all scores left out at either end
_AT_ONCE = 2**20  # scores that are drawn at a time

Statistic = Callable[[ndarray], ndarray]
"""From scores [..., N, M] to a number for each [...]."""


def interquartile_mean(scores: Float[ndarray, "*B N M"]) -> Float[ndarray, "*B"]:
    """Return the mean of the middle half of all runs' scores on all tasks; [...] of them at once.

    A quarter of the N M scores, rounded down, is left out at either end, as ``scipy.stats.trim_mean(scores, 0.25)``
    does.
    """
    ordered = np.sort(scores.reshape(*scores.shape[:-2], -1), axis=-1)
    cut = int(_TRIMMED * ordered.shape[-1])
    return np.asarray(ordered[..., cut : ordered.shape[-1] - cut].mean(-1))  # one number is an array, too


def stratified_interval(
    scores: Float[ndarray, "N M"], statistic: Statistic = interquartile_mean, repetitions: int = REPETITIONS
) -> tuple[float, float]:
    """Return the 95 % percentile interval of a statistic by stratified bootstrap.

    Each repetition draws N runs with replacement within each task, for each task anew. The draws are the same at every
    call.
    """
    runs, tasks = scores.shape
    rng = np.random.default_rng(0)
    at_once = max(1, _AT_ONCE // scores.size)
    found = []
    for first in range(0, repetitions, at_once):
        drawn = rng.integers(runs, size=(min(at_once, repetitions - first), runs, tasks))
        found.append(statistic(np.take_along_axis(scores[None], drawn, axis=1)))
    low, high = np.percentile(np.concatenate(found), [2.5, 97.5])
    return float(low), float(high)


def describe_scores(scores: list[float]) -> dict[str, Any]:
    """Return what ``summary.json`` tells of one task's scores; the interval is the interquartile mean's.

    One run has no interval: it says nothing of other seeds.
    """
    table = np.array(scores, np.float64)[:, None]
    low, high = stratified_interval(table) if len(scores) > 1 else (None, None)
    return {
        "seeds": len(scores),
        "iqm": float(interquartile_mean(table)),
        "iqm_low": low,
        "iqm_high": high,
        "mean": float(table.mean()),
        "median": float(np.median(table)),
        "least": float(table.min()),
        "greatest": float(table.max()),
    }
