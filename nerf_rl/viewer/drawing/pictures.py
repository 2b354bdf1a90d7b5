"""Pictures for people: a camera's colours, labels and depth side by side, scales and legends."""

import html
from collections.abc import Sequence

import cv2
import numpy as np
from jaxtyping import Float, UInt8
from numpy import ndarray

from nerf_rl.datasets.storage.frames import Frame
from nerf_rl.datasets.storage.stored_manifest import DEPTH, LABELS
from nerf_rl.pictures.images import colour_depth, colour_labels, surface_limits

_BACKGROUND = 255


def depth_limits(frame: Frame) -> tuple[float, float]:
    """Return limits [m] for the colours of depth in all pictures of a dataset that are like those of a frame."""
    return surface_limits(frame.depth, frame.far)


def magnify(image: UInt8[ndarray, "H W 3"], height: int) -> UInt8[ndarray, "A B 3"]:
    """Return an image scaled to a height [pixels]; whole pixels where it grows, averages where it shrinks."""
    width = max(1, round(image.shape[1] * height / image.shape[0]))
    kind = cv2.INTER_NEAREST if height >= image.shape[0] else cv2.INTER_AREA
    return cv2.resize(np.ascontiguousarray(image), (width, height), interpolation=kind)


def side_by_side(images: Sequence[UInt8[ndarray, "H W 3"]], height: int, gap: int = 4) -> UInt8[ndarray, "A B 3"]:
    """Return images in a row, scaled to one height [pixels]."""
    return joined([magnify(image, height) for image in images], gap, axis=1)


def stack(rows: Sequence[UInt8[ndarray, "_ _ 3"]], gap: int = 4) -> UInt8[ndarray, "A B 3"]:
    """Return rows of pictures below each other, each as wide as the widest."""
    widest = max(row.shape[1] for row in rows)
    padding = [((0, 0), (0, widest - row.shape[1]), (0, 0)) for row in rows]
    filled = [np.pad(row, pad, constant_values=_BACKGROUND) for row, pad in zip(rows, padding, strict=True)]
    return joined(filled, gap, axis=0)


def camera_strip(
    frame: Frame, view: int, palette: UInt8[ndarray, "C 3"], depth_range: tuple[float, float], height: int = 128
) -> UInt8[ndarray, "A B 3"]:
    """Return what one camera saw: colours, labels, depth; of these what there is."""
    pictures = [frame.rgb[view]]
    if LABELS not in frame.absent:
        pictures.append(colour_labels(frame.semantic[view], palette))
    if DEPTH not in frame.absent:
        pictures.append(colour_depth(frame.depth[view], *depth_range))
    return side_by_side(pictures, height)


def depth_scale(depth_range: tuple[float, float], width: int = 392, ticks: int = 5) -> UInt8[ndarray, "40 width 3"]:
    """Return a bar of depth's colours with its scale in metres."""
    near, far = depth_range
    picture = np.full((40, width, 3), _BACKGROUND, np.uint8)
    picture[:18] = colour_depth(np.linspace(near, far, width)[None], near, far)
    for i in range(ticks):
        text = f"{near + (far - near) * i / (ticks - 1):.2f} m"
        size = cv2.getTextSize(text, cv2.FONT_HERSHEY_SIMPLEX, 0.42, 1)[0][0]
        left = round((width - 1) * i / (ticks - 1) - size * i / (ticks - 1))
        _write(picture, text, (left, 34))
    return picture


def caption(text: str, width: int, height: int = 18) -> UInt8[ndarray, "height width 3"]:
    """Return a line of text as a picture."""
    picture = np.full((height, width, 3), _BACKGROUND, np.uint8)
    _write(picture, text, (2, height - 5))
    return picture


def legend(names: Sequence[str], palette: UInt8[ndarray, "C 3"]) -> str:
    """Return HTML that says which colour is which class."""
    box = "display:inline-block;width:.8em;height:.8em;margin:0 .35em 0 0;border-radius:2px"
    entries = [
        f'<span style="margin-right:.9em;white-space:nowrap">'
        f'<span style="{box};background:rgb{tuple(colour)}"></span>{html.escape(name)}</span>'
        for name, colour in zip(names, palette.tolist(), strict=True)
    ]
    return f'<div style="padding:.3em .8em;font-size:.8em;line-height:1.7">{"".join(entries)}</div>'


def heat(error: Float[ndarray, "H W"], most: float) -> UInt8[ndarray, "H W 3"]:
    """Return an error's heat map: black where it is 0, bright where it is ``most`` or more."""
    scaled = (255 * np.clip(error / most, 0.0, 1.0)).astype(np.uint8)
    return np.ascontiguousarray(cv2.applyColorMap(scaled, cv2.COLORMAP_INFERNO)[..., ::-1])


def _write(picture: ndarray, text: str, place: tuple[int, int]) -> None:
    cv2.putText(picture, text, place, cv2.FONT_HERSHEY_SIMPLEX, 0.42, (60, 60, 60), 1, cv2.LINE_AA)


def joined(images: Sequence[ndarray], gap: int, axis: int) -> UInt8[ndarray, "A B 3"]:
    """Return images that fit below each other (axis 0) or in a row (1), with a gap [pixels] between them."""
    shape = list(images[0].shape)
    shape[axis] = gap
    space = np.full(shape, _BACKGROUND, np.uint8)
    parts = [part for image in images for part in (space, image)][1:]
    return np.concatenate(parts, axis=axis)
