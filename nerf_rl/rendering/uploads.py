"""Textures and height fields, of which OpenGL has copies, are given to it anew once an environment has written others.

Ground that is made anew at each reset and surfaces that are painted at random would be drawn as they were at first.
"""

from collections.abc import Sequence

import mujoco
import numpy as np
from numpy import ndarray

from nerf_rl.rendering.offscreen_target import OffscreenTarget

_SAMPLES = 1024  # of a texture
_ALL_CHANNELS = 6  # a multiple of three and of four, beside which samples fall on each channel


class Uploads:
    """Keeps OpenGL's copies of a model's textures and height fields as the model has them.

    Height fields are compared whole each time. Textures are megabytes, so they are where time has not gone on since the
    last state, as after a reset; in the midst of an episode samples of each are compared, which shows whether it was
    painted anew but may miss a dot.

    Args:
        model: read at each call.
        targets: that have been made from the model as it is now, or from a copy of it.
    """

    def __init__(self, model: mujoco.MjModel, targets: Sequence[OffscreenTarget]):
        self._model, self._targets, self._time = model, targets, np.inf
        sizes = model.tex_height * model.tex_width * model.tex_nchannel
        parts = [slice(first, first + size) for first, size in zip(model.tex_adr, sizes, strict=True)]
        self._textures = [model.tex_data[part] for part in parts]
        self._samples = [
            texture[:: _ALL_CHANNELS * (len(texture) // _ALL_CHANNELS // _SAMPLES) + 1] for texture in self._textures
        ]
        self._fields = [model.hfield_data, model.hfield_size]
        self._seen_textures, self._seen_samples = _copies(self._textures), _copies(self._samples)
        self._seen_fields = _copies(self._fields)

    def refresh(self, data: mujoco.MjData) -> bool:
        """Give OpenGL what is otherwise than it was, before a state is drawn; tell whether anything was."""
        went_on, self._time = data.time > self._time, data.time
        fields = range(self._model.nhfield) if _differ(self._fields, self._seen_fields) else []
        now, seen = self._samples, self._seen_samples
        if not went_on or _differ(now, seen):
            now, seen = self._textures, self._seen_textures
        textures = [number for number, pair in enumerate(zip(now, seen, strict=True)) if not np.array_equal(*pair)]
        if not (textures or fields):
            return False
        for target in self._targets:
            target.make_current()
            for texture in textures:
                mujoco.mjr_uploadTexture(self._model, target.context, texture)
            for field in fields:
                mujoco.mjr_uploadHField(self._model, target.context, field)
        self._seen_textures, self._seen_samples = _copies(self._textures), _copies(self._samples)
        self._seen_fields = _copies(self._fields)
        return True


def _copies(arrays: Sequence[ndarray]) -> list[ndarray]:
    return [array.copy() for array in arrays]


def _differ(arrays: Sequence[ndarray], others: Sequence[ndarray]) -> bool:
    return not all(map(np.array_equal, arrays, others))
