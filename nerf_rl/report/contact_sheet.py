"""Contact sheets: what every camera of a dataset sees, as colours, labels and depth."""

from collections.abc import Sequence

from jaxtyping import UInt8
from numpy import ndarray

from nerf_rl.datasets.storage.reader import MultiViewDataset
from nerf_rl.pictures.images import colour_depth, colour_labels, surface_limits, tile


def contact_sheet(dataset: MultiViewDataset, frames: Sequence[int], factor: int = 2) -> UInt8[ndarray, "A B 3"]:
    """Return a sheet with a row each for RGB, labels and depth, and a column for every camera of every frame."""
    rgb, semantic, depth = dataset.read("rgb", frames), dataset.read_labels(frames), dataset.read("depth", frames)
    near, far = surface_limits(depth, dataset.manifest["far"])
    labels, depths = colour_labels(semantic, dataset.palette), colour_depth(depth, near, far)
    return tile([[image for frame in rows for image in frame] for rows in (rgb, labels, depths)], factor)
