"""Columns along an episode as lines."""

import numpy as np
from jaxtyping import Float
from numpy import ndarray


def as_lines(
    steps: Float[ndarray, "N"], values: list[Float[ndarray, "N"]]
) -> tuple[Float[ndarray, "M"], list[Float[ndarray, "M"]]]:
    """Return steps that ascend, and values beside them, for lines through an episode of N frames.

    Steps begin anew where an environment that ended early was reset. They are counted on there from the frame before,
    after a NaN in the values, across which Matplotlib draws no line (uPlot does).
    """
    resets = np.flatnonzero(np.diff(steps) <= 0) + 1
    before = np.zeros(len(steps))
    before[resets] = steps[resets - 1] + 1
    ascending = steps + np.cumsum(before)
    gapped = np.insert(ascending, resets, ascending[resets] - 0.5)
    return gapped, [np.insert(column, resets, np.nan) for column in values]


def plotted_together(names: list[str]) -> dict[str, list[str]]:
    """Gather columns that belong in one plot: positions of one thing, all actions."""
    groups: dict[str, list[str]] = {}
    for name in names:
        groups.setdefault(name.rpartition("_")[0] or name, []).append(name)
    return groups
