"""Pictures of what the field renders from z beside what the cameras saw."""

import numpy as np
from jaxtyping import UInt8
from numpy import ndarray

from nerf_rl.datasets.storage.stored_manifest import DEPTH, LABELS
from nerf_rl.pictures.images import colour_depth, colour_labels, surface_limits, tile
from nerf_rl.pretrain.objectives.snerl_module import SnerlModule


def reconstruction_grid(module: SnerlModule, frames: list[int], factor: int = 2) -> UInt8[ndarray, "A B 3"]:
    """Return a grid with two rows a frame, truth above rendering; columns are the cameras' RGB, labels, depth.

    Of a dataset without depth that of the rendering stands below white; without labels, the field has learnt none.
    """
    truths, rows = [module.truth(frame) for frame in frames], []
    bounds, has_depth, has_labels = module.field.bounds, DEPTH not in module.absent, LABELS not in module.absent
    limits = surface_limits(np.stack([truth["depth"] for truth in truths]), min(module.far, bounds.far))
    limits = limits if has_depth else (bounds.near, bounds.far)
    for frame, truth in zip(frames, truths, strict=True):
        rendered = module.render_frame(frame)
        for rgb, labels, depth in (
            (truth["rgb"], truth["semantic"], truth["depth"] if has_depth else None),
            (rendered.rgb, rendered.semantic, rendered.depth),
        ):
            colours = (255 * rgb).round().astype(np.uint8)
            coloured_labels = [*colour_labels(labels, module.palette)] if has_labels else []
            coloured_depth = np.full_like(colours, 255) if depth is None else colour_depth(depth, *limits)
            rows.append([*colours, *coloured_labels, *coloured_depth])
    return tile(rows, factor)
