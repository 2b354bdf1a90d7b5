"""Depth in LeRobot's 12 bits: codes that are evenly spaced in the logarithm, so that the error is a share of the depth.

code = round(4095 log(depth / nearest) / log(farthest / nearest)), which LeRobot calls depth_min, depth_max, shift 0 and
use_log. The topmost code, 4095, is kept for pixels where nothing was hit; they are read as ``farthest``.
"""

import math
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Float32, UInt16
from numpy import ndarray

TOPMOST = 4095
"""code where nothing was hit"""
_NEAREST = 1e-4  # [m]
_LEAST_RATIO = 1.001  # of the farthest to the nearest depth, for a camera that sees a wall or nothing at all


@dataclass(frozen=True)
class DepthCodes:
    """How depth of one camera becomes codes."""

    nearest: float
    """depth of the code 0 [m]"""
    farthest: float
    """depth of the topmost code, beyond all that was hit [m]"""

    @classmethod
    def for_range(cls, nearest: float, farthest: float) -> "DepthCodes":
        """Return the codes whose range begins with the nearest hit and ends one code beyond the farthest [m]."""
        nearest = max(nearest, _NEAREST)
        ratio = max(farthest / nearest, _LEAST_RATIO)
        return cls(nearest, nearest * ratio ** (TOPMOST / (TOPMOST - 1)))

    def encode(self, depth: Float32[ndarray, "*N"], hit: float) -> UInt16[ndarray, "*N"]:
        """Return codes.

        Args:
            depth: planar [m].
            hit: depth from which on nothing was hit [m].
        """
        scale = TOPMOST / math.log(self.farthest / self.nearest)
        codes = np.rint(np.log(np.maximum(depth, self.nearest) / np.float32(self.nearest)) * np.float32(scale))
        return np.where(depth < hit, np.minimum(codes, TOPMOST - 1), TOPMOST).astype(np.uint16)

    def decode(self, codes: ndarray) -> Float[ndarray, "*N"]:
        """Return the depth of codes [m]."""
        return self.nearest * np.exp(codes * (math.log(self.farthest / self.nearest) / TOPMOST))
