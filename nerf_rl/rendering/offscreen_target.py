"""An off-screen OpenGL image, as tall as OpenGL lets it be, that views are drawn to as tiles."""

import mujoco

from nerf_rl.errors import UserError
from nerf_rl.machine.gl import largest_image, renderer_name

_MOST_PIXELS = 2**24  # of an image; several views of larger ones would take memory and save no time


class OffscreenTarget:
    """An OpenGL context with an off-screen image, and the model's meshes and textures in it.

    Args:
        model: what is drawn.
        height, width: of one tile [pixels].
        tiles: one above another, at most; there may be fewer, since OpenGL limits the sides of images.
        shadow_map: side of the map of shadows [pixels]; 0: none.
        samples: of a pixel; 0: no multisampling.

    Attributes:
        height, width: of one tile [pixels].
        tiles: how many there are.

    Raises:
        UserError: OpenGL cannot draw an image of one tile.
    """

    def __init__(self, model: mujoco.MjModel, height: int, width: int, tiles: int, shadow_map: int, samples: int):
        self.height, self.width, self.has_shadows = height, width, shadow_map > 0
        self._gl: mujoco.GLContext | None = mujoco.GLContext(1, 1)  # of a window's image, which nothing is drawn to
        self._gl.make_current()
        try:
            self.tiles = _tiles(height, width, tiles)
            self.context = self._make_context(model, self.tiles * height, width, shadow_map, samples)
        except UserError:
            self._gl.free()
            raise
        mujoco.mjr_setBuffer(mujoco.mjtFramebuffer.mjFB_OFFSCREEN, self.context)
        self.context.readDepthMap = mujoco.mjtDepthMap.mjDEPTH_ZEROFAR  # keeps float precision far away

    @staticmethod
    def _make_context(
        model: mujoco.MjModel, height: int, width: int, shadow_map: int, samples: int
    ) -> mujoco.MjrContext:
        visual, size = model.vis, (model.vis.global_.offwidth, model.vis.global_.offheight)
        quality = (visual.quality.shadowsize, visual.quality.offsamples)
        visual.global_.offwidth, visual.global_.offheight = width, height
        visual.quality.shadowsize, visual.quality.offsamples = shadow_map, samples  # read when the context is made
        try:
            return mujoco.MjrContext(model, mujoco.mjtFontScale.mjFONTSCALE_100)
        except mujoco.FatalError as error:
            raise UserError(
                f"OpenGL ({renderer_name()}) cannot make an image of {width} x {height} pixels with {max(1, samples)} "
                f"samples each: {error}"
            ) from error
        finally:
            visual.global_.offwidth, visual.global_.offheight = size
            visual.quality.shadowsize, visual.quality.offsamples = quality

    def make_current(self) -> None:
        """Let what is drawn next be drawn here; raise RuntimeError if the target is closed."""
        if self._gl is None:
            raise RuntimeError("the renderer is closed")
        self._gl.make_current()

    def close(self) -> None:
        """Free the OpenGL resources."""
        if self._gl is not None:
            self._gl.make_current()
            self.context.free()
            self._gl.free()
            self._gl = None


def _tiles(height: int, width: int, wanted: int) -> int:
    """Return how many tiles of so many pixels an image may have, up to those wanted."""
    most_rows, most_columns = largest_image()
    if height > most_rows or width > most_columns:
        raise UserError(
            f"a view of {width} x {height} pixels is larger than what OpenGL draws here; the limit of "
            f"{renderer_name()} is {most_columns} x {most_rows} pixels"
        )
    return min(wanted, most_rows // height, max(1, _MOST_PIXELS // (height * width)))
