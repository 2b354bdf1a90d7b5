"""A frame's cameras beside what the radiance field renders from its latent."""

from collections.abc import Callable

import numpy as np
from jaxtyping import Float, UInt8
from numpy import ndarray

from nerf_rl.datasets.storage.frames import Frame
from nerf_rl.datasets.storage.stored_manifest import DEPTH, LABELS
from nerf_rl.pictures.images import colour_depth, colour_labels
from nerf_rl.pretrain.model.conditioned_field import ConditionedField
from nerf_rl.pretrain.model.ray_rendering import RenderedImages
from nerf_rl.viewer.drawing.pictures import camera_strip, heat, side_by_side, stack
from nerf_rl.viewer.field.progressive import FreeCamera, Picture, render_progressively

_MOST_COLOUR_ERROR = 0.3  # mean over channels in [0, 1]
_MOST_DEPTH_ERROR = 0.1  # [m]


def render_views(
    field: ConditionedField,
    intrinsics: Float[ndarray, "V 3 3"],
    camera_from_world: Float[ndarray, "V 4 4"],
    size: tuple[int, int],
    stale: Callable[[], bool] = lambda: False,
) -> list[RenderedImages] | None:
    """Return what the field renders for cameras of a height and width [pixels]; None if it is not wanted any more."""
    rendered, longer = [], max(size)
    for view in range(len(intrinsics)):
        camera = FreeCamera.of_view(intrinsics[view], camera_from_world[view], *size)
        finest = list(render_progressively(field, camera, max(8, longer // 2), [Picture(longer)], stale))
        if len(finest) < 2:
            return None
        rendered.append(finest[-1])
    return rendered


def comparison(
    frame: Frame,
    view: int,
    rendered: RenderedImages,
    palette: UInt8[ndarray, "C 3"],
    depth_range: tuple[float, float],
    far: float,
    height: int = 112,
) -> UInt8[ndarray, "A B 3"]:
    """Return three rows, truth, rendering and error, of colours, labels and depth.

    Errors are black where there is none, and bright from 0.3 in colour and 0.1 m in depth; wrong labels are white.
    Depth counts where the truth is nearer than ``far`` [m], since the field ends there. Of a dataset without depth,
    that of the field is shown alone; without labels, the field has learnt none.
    """
    truth = camera_strip(frame, view, palette, depth_range, height)
    decoded = [(255 * rendered.rgb[0]).round().astype(np.uint8)]
    if LABELS not in frame.absent:
        decoded.append(colour_labels(rendered.semantic[0], palette))
    decoded.append(colour_depth(rendered.depth[0], *depth_range))
    rows = [truth, side_by_side(decoded, height), side_by_side(errors(frame, view, rendered, far), height)]
    return stack(rows)


def errors(frame: Frame, view: int, rendered: RenderedImages, far: float) -> list[UInt8[ndarray, "H W 3"]]:
    """Return heat maps of the errors in colour, labels and depth, the latter where the truth is nearer than ``far``.

    There is none of what the frame's dataset lacks.
    """
    maps = [heat(np.abs(rendered.rgb[0] - frame.rgb[view] / 255.0).mean(-1), _MOST_COLOUR_ERROR)]
    if LABELS not in frame.absent:
        wrong = np.where(rendered.semantic[0] != frame.semantic[view], 255, 0).astype(np.uint8)
        maps.append(np.repeat(wrong[..., None], 3, axis=-1))
    if DEPTH not in frame.absent:
        depth = np.where(frame.depth[view] < far, np.abs(rendered.depth[0] - frame.depth[view]), 0.0)
        maps.append(heat(depth, _MOST_DEPTH_ERROR))
    return maps
