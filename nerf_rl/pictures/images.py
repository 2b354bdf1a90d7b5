"""Arrays as pictures: colours for depth and labels, and grids of images."""

import cv2
import numpy as np
from jaxtyping import Bool, Float, Integer, UInt8
from numpy import ndarray

_BACKGROUND = 0.95  # of the far plane's depth; a field blends background with what is before it
_QUANTILES = (0.01, 0.8)  # of surfaces: a gripper before a lens, and a floor's far end, would take most colours


def colour_depth(depth: Float[ndarray, "*S"], near: float, far: float) -> UInt8[ndarray, "*S 3"]:
    """Return RGB colours of depth between two limits [m]; what is far is dark."""
    scaled = np.clip((depth - near) / max(far - near, 1e-6), 0.0, 1.0)
    grey = (255 * (1.0 - scaled)).astype(np.uint8)
    colours = cv2.applyColorMap(grey.reshape(-1, 1), cv2.COLORMAP_VIRIDIS)[..., ::-1]
    return np.ascontiguousarray(colours).reshape(*depth.shape, 3)


def is_surface(depth: Float[ndarray, "*S"], far: float) -> Bool[ndarray, "*S"]:
    """Tell where something was hit: nearer than the far plane, which lies at ``far`` [m]."""
    return depth < _BACKGROUND * far


def surface_limits(depth: Float[ndarray, "*S"], far: float) -> tuple[float, float]:
    """Return limits [m] for the colours of depth: the nearest surfaces, and one behind most of the others.

    What lies at the far plane is background: nothing was hit there, and how far off the plane is says nothing of the
    scene. It may be most of a picture and a hundred times as far as all else, so it is left out; beyond the limits,
    depth has the colour of the nearer one.

    Args:
        depth: planar [m].
        far: depth of the far plane [m].
    """
    seen = depth[is_surface(depth, far)]
    if not seen.size:
        return 0.0, far
    near, most = np.quantile(seen, _QUANTILES)
    return float(near), float(most)


def colour_labels(labels: Integer[ndarray, "*S"], palette: UInt8[ndarray, "C 3"]) -> UInt8[ndarray, "*S 3"]:
    """Return the palette's colours of class ids."""
    return palette[labels]


def tile(rows: list[list[UInt8[ndarray, "H W 3"]]], factor: int = 1, gap: int = 2) -> UInt8[ndarray, "A B 3"]:
    """Arrange images of one size in rows, each pixel repeated ``factor`` times, with white gaps [pixels]."""
    lines = []
    for row in rows:
        large = [np.repeat(np.repeat(image, factor, axis=0), factor, axis=1) for image in row]
        padded = [np.pad(image, ((0, gap), (0, gap), (0, 0)), constant_values=255) for image in large]
        lines.append(np.concatenate(padded, axis=1))
    return np.concatenate(lines, axis=0)
