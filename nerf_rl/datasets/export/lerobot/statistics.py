"""Statistics of features as LeRobot keeps them: of each episode, and put together for the dataset.

A feature's statistics are min, max, mean, std, count and five quantiles. Those of colours are in [0, 1] by channel,
with the shape (3, 1, 1); those of depth are in metres, with the shape (1, 1, 1); others have the feature's shape.
"""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float, Int
from numpy import ndarray

Statistics = dict[str, ndarray]
QUANTILES = {"q01": 0.01, "q10": 0.10, "q50": 0.50, "q90": 0.90, "q99": 0.99}


def of_values(values: ndarray) -> Statistics:
    """Return the statistics of T values of any shape; of scalars they have the shape (1,)."""
    rows = values.astype(np.float64).reshape(len(values), *(values.shape[1:] or (1,)))
    levels = np.quantile(rows, list(QUANTILES.values()), axis=0)
    return {
        "min": rows.min(0),
        "max": rows.max(0),
        "mean": rows.mean(0),
        "std": rows.std(0),
        "count": np.array([len(rows)]),
        **dict(zip(QUANTILES, levels, strict=True)),
    }


def of_histograms(counts: Int[ndarray, "C L"], values: Float[ndarray, "L"], frames: int) -> Statistics:
    """Return the statistics of pictures.

    Args:
        counts: how often each of L levels occurs in each channel.
        values: of the levels, ascending.
        frames: how many pictures were counted.
    """
    total = counts.sum(1, keepdims=True)
    mean = (counts @ values)[:, None] / total
    spread = np.sqrt((counts * (values[None] - mean) ** 2).sum(1, keepdims=True) / total)
    reached = counts.cumsum(1) / total

    def level(share: float) -> Float[ndarray, "C 1"]:
        return values[np.argmax(reached >= share, axis=1)][:, None]

    highest = values[counts.shape[1] - 1 - np.argmax(counts[:, ::-1] > 0, axis=1)][:, None]
    found = {"min": level(1e-300), "max": highest, "mean": mean, "std": spread}
    found |= {name: level(share) for name, share in QUANTILES.items()}
    return {**{name: value[..., None] for name, value in found.items()}, "count": np.array([frames])}


def together(parts: Sequence[Statistics]) -> Statistics:
    """Return the statistics of several episodes as one; quantiles are averaged, as LeRobot does."""
    counts = np.array([part["count"][0] for part in parts], np.float64)
    shares = counts / counts.sum()

    def average(values: list[ndarray]) -> ndarray:
        return np.tensordot(shares, np.stack(values), 1)

    mean = average([part["mean"] for part in parts])
    variance = average([part["std"] ** 2 + (part["mean"] - mean) ** 2 for part in parts])
    return {
        "min": np.min([part["min"] for part in parts], axis=0),
        "max": np.max([part["max"] for part in parts], axis=0),
        "mean": mean,
        "std": np.sqrt(variance),
        "count": np.array([int(counts.sum())]),
        **{name: average([part[name] for part in parts]) for name in QUANTILES},
    }
