"""What the cells of an encoder's pictures show: the labels that its landmarks are learnt from."""

import numpy as np
from jaxtyping import Bool, Float, UInt8
from numpy import ndarray

from nerf_rl.pretrain.data.anchors import Anchors

_IDS = 256  # of classes, as many as a byte has


class CellShares:
    """Counts which share of each cell of a picture shows which of the classes that move.

    Args:
        anchors: those classes.
        patch: side of a cell [pixels].
    """

    def __init__(self, anchors: Anchors, patch: int):
        self._patch, self._classes = patch, len(anchors.classes)
        self._place = np.zeros(_IDS, np.uint8)  # of a class among the shares; 0 for all that is not looked for
        self._place[list(anchors.classes)] = np.arange(1, self._classes + 1)
        share = np.concatenate([[1.0 - anchors.share.sum()], anchors.share])
        rarity = np.maximum(share, 1e-5) ** -0.5
        self._weights = (rarity / (share * rarity).sum()).astype(np.float32)

    def of(
        self, labels: UInt8[ndarray, "B V H W"], valid: Bool[ndarray, "B V H W"] | None
    ) -> Float[ndarray, "B V C h w"]:
        """Return the shares of whole cells, each class's multiplied by a weight; their mean over all pixels is 1.

        C is one more than the classes, and the first is of all other things. Weights are a class's frequency to the
        power of -1/2, so that a ball of ten pixels counts beside a robot.

        Args:
            labels: class ids.
            valid: which pixels count; all if None.
        """
        height, width = (size // self._patch for size in labels.shape[2:])
        covered = (..., slice(height * self._patch), slice(width * self._patch))
        places = self._place[labels[covered]]
        nobodys = self._classes + 1
        if valid is not None:
            places = np.where(valid[covered], places, np.uint8(nobodys))
        grid = (*labels.shape[:2], height, width)
        cells = np.arange(np.prod(grid), dtype=np.int64).reshape(*grid[:3], 1, width, 1) * (nobodys + 1)
        pixels = places.reshape(*grid[:3], self._patch, width, self._patch)
        counts = np.bincount((cells + pixels).ravel(), minlength=int(np.prod(grid)) * (nobodys + 1))
        counts = np.moveaxis(counts.reshape(*grid, nobodys + 1)[..., :nobodys], -1, 2)
        return counts * (self._weights / self._patch**2)[:, None, None]
