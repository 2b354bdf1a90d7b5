"""What makes a frame unusable: views that show nothing, numbers that are not finite.

A view of a single colour may be right (a wrist camera close to a wall), so its depth decides: a picture that is black,
or of one colour at one depth, shows nothing: rendering failed, or the camera looks past the scene.
"""

from collections.abc import Iterator

import numpy as np
from jaxtyping import Float, UInt8
from numpy import ndarray


def view_faults(
    rgb: UInt8[ndarray, "*frames H W 3"], depth: Float[ndarray, "*frames H W"]
) -> Iterator[tuple[tuple[int, ...], str]]:
    """Yield the index of each unusable view, and what is wrong with it.

    Args:
        rgb: colours; the leading dimensions are any, such as frames and cameras.
        depth: planar depth [m].
    """
    finite = np.isfinite(depth).all((-2, -1))
    one_colour = (rgb == rgb[..., :1, :1, :]).all((-3, -2, -1))
    black = one_colour & (rgb[..., 0, 0, :] == 0).all(-1)
    one_depth = (depth == depth[..., :1, :1]).all((-2, -1))
    for index in map(tuple, np.argwhere(~finite | black | (one_colour & one_depth)).tolist()):
        fault = "has a depth that is not finite" if not finite[index] else "sees nothing: its picture is "
        if finite[index]:
            fault += "black" if black[index] else "of one colour at one depth"
        yield index, fault


def array_faults(values: ndarray) -> Iterator[str]:
    """Yield what is wrong with an array's numbers, if anything."""
    if values.dtype.kind == "f" and not np.isfinite(values).all():
        yield "is not finite"
