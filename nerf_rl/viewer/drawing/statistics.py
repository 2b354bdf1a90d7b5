"""What a dataset holds as a whole, from a sample of its frames."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from nerf_rl.datasets.storage.frames import named_points
from nerf_rl.datasets.storage.reader import MultiViewDataset
from nerf_rl.datasets.storage.stored_manifest import LABELS
from nerf_rl.viewer.timeline import Timeline


@dataclass(frozen=True)
class Statistics:
    """Of a dataset's sampled episodes."""

    places: dict[str, Float[ndarray, "E 2"]]
    """horizontal position [m] of each named thing in the first frame that was kept of E episodes"""
    class_shares: dict[str, float]
    """share of all pixels of those frames; none where the dataset has no labels"""


def sample_statistics(dataset: MultiViewDataset, episodes: int = 200) -> Statistics:
    """Return statistics of evenly spread episodes, from the first frame of each, be it long after the reset.

    The cost depends on ``episodes``, not on the size of the dataset.
    """
    timeline = Timeline(dataset)
    count = min(episodes, timeline.last - timeline.first + 1)
    chosen = np.unique(np.linspace(timeline.first, timeline.last, count).astype(int))
    places: dict[str, list[tuple[float, float]]] = {}
    names = () if LABELS in dataset.absent else dataset.class_names
    pixels = np.zeros(len(names), np.int64)
    for episode in chosen.tolist():
        frame = timeline.frames(episode).start
        values = dataset.read("state/privileged", [frame])[0]
        for name, (x, y, _) in named_points(dataset.columns("privileged"), values).items():
            places.setdefault(name, []).append((x, y))
        if names:
            pixels += np.bincount(dataset.read_labels([frame]).ravel(), minlength=len(pixels))[: len(pixels)]
    shares = (pixels / max(1, pixels.sum())).tolist()
    return Statistics(
        {name: np.array(xy) for name, xy in places.items()},
        dict(zip(names, shares, strict=True)),
    )
