"""Pictures of what the field renders from z beside what the cameras saw."""

import numpy as np
from jaxtyping import UInt8
from numpy import ndarray

from nerf_rl.pictures.images import colour_depth, colour_labels, surface_limits, tile
from nerf_rl.pretrain.objectives.snerl_module import SnerlModule


def reconstruction_grid(module: SnerlModule, frames: list[int], factor: int = 2) -> UInt8[ndarray, "A B 3"]:
    """Return a grid with two rows a frame, truth above rendering; columns are the cameras' RGB, labels, depth."""
    truths, rows = [module.truth(frame) for frame in frames], []
    limits = surface_limits(np.stack([truth["depth"] for truth in truths]), min(module.far, module.field.bounds.far))
    for frame, truth in zip(frames, truths, strict=True):
        rendered = module.render_frame(frame)
        for rgb, labels, depth in (
            (truth["rgb"], truth["semantic"], truth["depth"]),
            (rendered.rgb, rendered.semantic, rendered.depth),
        ):
            colours = (255 * rgb).round().astype(np.uint8)
            rows.append([*colours, *colour_labels(labels, module.palette), *colour_depth(depth, *limits)])
    return tile(rows, factor)
