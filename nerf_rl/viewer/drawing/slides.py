"""Each frame as one picture with a caption: what pages, contact sheets and videos are made of."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import numpy as np
from jaxtyping import UInt8
from numpy import ndarray

from nerf_rl.datasets.storage.frames import Frame, read_frame
from nerf_rl.datasets.storage.reader import MultiViewDataset
from nerf_rl.viewer.drawing.pictures import caption, joined, stack

Picture = Callable[[Frame, int], UInt8[ndarray, "_ _ 3"]]
"""From a frame and the number of a camera to its picture."""


@dataclass(frozen=True)
class Slide:
    """A picture and what it shows."""

    picture: UInt8[ndarray, "A B 3"]
    caption: str


DrawSlide = Callable[[], Slide]
"""Draws a slide when it is needed: a contact sheet has room for a few of many."""


def evenly_chosen(total: int, count: int) -> list[int]:
    """Return places evenly spread over ``total``, the first and the last among them, at most ``count``."""
    return np.unique(np.linspace(0, total - 1, min(count, total)).astype(int)).tolist()


def dataset_slides(dataset: MultiViewDataset, frames: list[int], draw: Picture) -> list[DrawSlide]:
    """Return a slide a frame: every camera's picture under its name, in two columns."""
    return [partial(_dataset_slide, dataset, index, draw) for index in frames]


def in_columns(cells: list[UInt8[ndarray, "A B 3"]], columns: int, gap: int = 8) -> UInt8[ndarray, "H W 3"]:
    """Return pictures of one size in rows of ``columns``."""
    blank = np.full_like(cells[0], 255)
    padded = [*cells, *[blank] * (-len(cells) % columns)]
    rows = [joined(padded[start : start + columns], gap, axis=1) for start in range(0, len(padded), columns)]
    return stack(rows, gap)


def _dataset_slide(dataset: MultiViewDataset, index: int, draw: Picture) -> Slide:
    frame = read_frame(dataset, index)
    cells = []
    for view, name in enumerate(dataset.camera_names):
        picture = draw(frame, view)
        cells.append(stack([caption(name, picture.shape[1]), picture], gap=0))
    text = f"frame {index}, episode {frame.episode}, step {frame.step}, {frame.split}"
    return Slide(in_columns(cells, 2), text)
