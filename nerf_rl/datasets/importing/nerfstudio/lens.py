"""Lenses that bend straight lines: their pictures are unbent, since a dataset's cameras are pinholes.

The model is OpenCV's, of which nerfstudio takes the names: radial terms k1, k2, k3 and tangential ones p1, p2.
"""

from collections.abc import Mapping
from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray

COEFFICIENTS = ("k1", "k2", "p1", "p2", "k3", "k4")
_MOST = 100.0


@dataclass(frozen=True)
class Lens:
    """Coefficients k1, k2, p1, p2 and k3."""

    coefficients: tuple[float, ...]

    @classmethod
    def of(cls, named: Mapping[str, float]) -> "Lens | None":
        """Return the lens with some coefficients, None if it bends nothing.

        Raises:
            ValueError: a coefficient is of another model, or too large.
        """
        values = tuple(named[key] for key in COEFFICIENTS)
        if values[-1]:
            raise ValueError("its lens has a fourth radial term (k4), and only OpenCV's k1, k2, k3, p1, p2 are taken")
        if max(map(abs, values)) > _MOST:
            raise ValueError(f"a coefficient of its lens is above {_MOST:g}")
        return cls(values[:-1]) if any(values) else None

    def maps(self, intrinsics: Float[ndarray, "3 3"], height: int, width: int) -> tuple[ndarray, ndarray]:
        """Return where each pixel of a pinhole's picture, with the same K, lies in the bent one: x and y [H, W]."""
        K = intrinsics.copy()
        K[:2, 2] -= 0.5  # OpenCV's pixels have their centres at whole numbers
        bends, as_it_looks = np.array(self.coefficients), np.eye(3)
        x, y = cv2.initUndistortRectifyMap(K, bends, as_it_looks, K, (width, height), cv2.CV_32FC1)
        return x, y


def unbend(picture: ndarray, maps: tuple[ndarray, ndarray]) -> ndarray:
    """Return a picture as a pinhole would see it: colours are interpolated, other numbers are those of the nearest.

    What the bent picture does not show is zero.
    """
    kind = cv2.INTER_LINEAR if picture.ndim == 3 else cv2.INTER_NEAREST
    unbent = cv2.remap(picture, *maps, kind, borderMode=cv2.BORDER_REPLICATE)  # else the rim would be mixed with black
    unbent[~shown(maps, *picture.shape[:2])] = 0
    return unbent


def shown(maps: tuple[ndarray, ndarray], height: int, width: int) -> Bool[ndarray, "H W"]:
    """Tell which pixels the bent picture of this size shows."""
    x, y = maps
    return (x >= -0.5) & (x <= width - 0.5) & (y >= -0.5) & (y <= height - 0.5)
