"""Pictures of what the field renders from z beside what the cameras saw."""

import numpy as np
from jaxtyping import UInt8
from numpy import ndarray

from nerf_rl.images import colour_depth, colour_labels, tile
from nerf_rl.pretrain.module import SnerlModule


def reconstruction_grid(module: SnerlModule, frames: list[int], factor: int = 2) -> UInt8[ndarray, "A B 3"]:
    """Return a grid with two rows a frame, truth above rendering; columns are the cameras' RGB, labels, depth."""
    near, far, rows = module.field.bounds.near, module.field.bounds.far, []
    for frame in frames:
        truth, rendered = module.truth(frame), module.render_frame(frame)
        for rgb, labels, depth in (
            (truth["rgb"], truth["semantic"], truth["depth"]),
            (rendered.rgb, rendered.semantic, rendered.depth),
        ):
            colours = (255 * rgb).round().astype(np.uint8)
            rows.append([*colours, *colour_labels(labels, module.palette), *colour_depth(depth, near, far)])
    return tile(rows, factor)
