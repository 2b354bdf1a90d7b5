"""Multi-view rendering: RGB, depth and labels of one simulation state from many cameras, in few passes.

All views are tiles of one off-screen image, which is read back once. Depth comes out of the colour pass, labels out of
a second one in which each geom has its own colour. Sites are not drawn, since goal markers would give the goal away.
"""

import copy
from typing import NamedTuple

import mujoco
import numpy as np
from jaxtyping import Bool, Float, Int32, UInt8
from numpy import ndarray

from nerf_rl.cameras import camera_position
from nerf_rl.datasets.level_of_detail import simplify_meshes

_HIDDEN_GROUP = 5  # of geoms; not drawn by default
_FULL_SHADOW_MAP = 4096
_FULL_SAMPLES = 4


class Views(NamedTuple):
    """What several cameras see of one state."""

    rgb: UInt8[ndarray, "V H W 3"]
    depth: Float[ndarray, "V H W"]
    """planar depth [m]; the far plane's where nothing is hit"""
    geom: Int32[ndarray, "V H W"]
    """geom id; -1 where no geom is hit"""


class MultiViewRenderer:
    """Renders a model from any cameras.

    Args:
        model: the simulated model; positions, colours and sizes are read from it at each call.
        height, width: of one view [pixels].
        views: the most cameras a call may have.
        quality: ``fast`` (meshes simplified for the image size, no shadows, no multisampling) or ``full``.
    """

    def __init__(self, model: mujoco.MjModel, height: int, width: int, views: int, quality: str = "fast"):
        self._model, self._height, self._width, self._views = model, height, width, views
        drawn = simplify_meshes(model, height) if quality == "fast" else copy.deepcopy(model)
        self._plain = _OffscreenTarget(drawn, views * height, width, shadow_map=0, samples=0)
        self._fine = (
            _OffscreenTarget(drawn, views * height, width, _FULL_SHADOW_MAP, _FULL_SAMPLES)
            if quality == "full"
            else None
        )
        self._option = mujoco.MjvOption()
        self._option.sitegroup[:] = 0
        self._camera = mujoco.MjvCamera()
        self._scene = mujoco.MjvScene(model, maxgeom=model.ngeom + 1000)
        self._near = float(model.vis.map.znear * model.stat.extent)
        self.far = float(model.vis.map.zfar * model.stat.extent)
        self._rgb = np.empty((views * height, width, 3), np.uint8)
        self._buffer_depth = np.empty((views * height, width), np.float32)

    @property
    def gl_renderer(self) -> str:
        """The OpenGL implementation's name for itself."""
        from OpenGL import GL

        self._plain.make_current()
        return GL.glGetString(GL.GL_RENDERER).decode()

    def render(
        self,
        data: mujoco.MjData,
        intrinsics: Float[ndarray, "V 3 3"],
        camera_from_world: Float[ndarray, "V 4 4"],
    ) -> Views:
        """Render colours, depth and geom ids.

        Args:
            data: the state, with positions propagated (after ``mj_step`` or ``mj_forward``).
            intrinsics: K [pixels], with square pixels and a centred principal point.
            camera_from_world: poses.
        """
        labels = np.empty((len(intrinsics), self._height, self._width), np.int32)
        if self._fine is None:
            rgb = self._pass(self._plain, data, intrinsics, camera_from_world, depth=True)
            self._pass(self._plain, data, intrinsics, camera_from_world, labels=labels)
        else:
            rgb = self._pass(self._fine, data, intrinsics, camera_from_world)
            self._pass(self._plain, data, intrinsics, camera_from_world, depth=True, labels=labels)
        buffer = self._tiles(self._buffer_depth, len(intrinsics))
        depth = self._near * self.far / (self._near + buffer * (self.far - self._near))
        return Views(rgb, depth.astype(np.float32), labels)

    def render_rgb(
        self,
        data: mujoco.MjData,
        intrinsics: Float[ndarray, "V 3 3"],
        camera_from_world: Float[ndarray, "V 4 4"],
    ) -> UInt8[ndarray, "V H W 3"]:
        """Render colours alone, the same as in :meth:`render`."""
        return self._pass(self._fine or self._plain, data, intrinsics, camera_from_world)

    def close(self) -> None:
        """Free the OpenGL resources."""
        for target in (self._plain, self._fine):
            if target is not None:
                target.close()

    def _pass(
        self,
        target: "_OffscreenTarget",
        data: mujoco.MjData,
        intrinsics: ndarray,
        camera_from_world: ndarray,
        depth: bool = False,
        labels: Int32[ndarray, "V H W"] | None = None,
    ) -> UInt8[ndarray, "V H W 3"]:
        """Draw all views and read them back; fill ``labels`` with geom ids if given. Returns a copy of the colours."""
        count = len(intrinsics)
        if count > self._views:
            raise ValueError(f"this renderer was made for {self._views} views, got {count}")
        target.make_current()
        flags = self._scene.flags
        flags[mujoco.mjtRndFlag.mjRND_SHADOW] = flags[mujoco.mjtRndFlag.mjRND_REFLECTION] = target.has_shadows
        flags[mujoco.mjtRndFlag.mjRND_SEGMENT] = flags[mujoco.mjtRndFlag.mjRND_IDCOLOR] = labels is not None
        geom_of_segment = []
        for view in range(count):
            self._update_scene(data, intrinsics[view], camera_from_world[view])
            tile = mujoco.MjrRect(0, view * self._height, self._width, self._height)
            mujoco.mjr_render(tile, self._scene, target.context)
            if labels is not None:
                geom_of_segment.append(self._geom_of_segment())
        rect = mujoco.MjrRect(0, 0, self._width, count * self._height)
        rgb = self._rgb[: count * self._height]
        buffer_depth = self._buffer_depth[: count * self._height] if depth else None
        mujoco.mjr_readPixels(rgb, buffer_depth, rect, target.context)
        colours = self._tiles(self._rgb, count)
        if labels is not None:
            segment = colours[..., 0].astype(np.int32) | colours[..., 1].astype(np.int32) << 8
            for view in range(count):
                labels[view] = geom_of_segment[view][segment[view]]
        return colours.copy()

    def _tiles(self, atlas: ndarray, count: int) -> ndarray:
        """Return the views, each with its top row first; OpenGL reads rows back from the bottom."""
        stacked = atlas[: count * self._height]
        return stacked.reshape(count, self._height, self._width, *atlas.shape[2:])[:, ::-1]

    def _update_scene(self, data: mujoco.MjData, intrinsics: ndarray, camera_from_world: ndarray) -> None:
        """Fill the scene with the geoms that the camera may see, and set the camera."""
        model = self._model
        groups = model.geom_group.copy()
        outside = self._outside_frustum(data, intrinsics, camera_from_world)
        model.geom_group[outside] = _HIDDEN_GROUP  # how to leave geoms out of a scene; nothing else reads it meanwhile
        try:
            mujoco.mjv_updateScene(
                model, data, self._option, None, self._camera, mujoco.mjtCatBit.mjCAT_ALL.value, self._scene
            )
        finally:
            model.geom_group[:] = groups
        tangent = 0.5 * self._height / intrinsics[1, 1]
        for camera in self._scene.camera:
            camera.pos = camera_position(camera_from_world)
            camera.forward = camera_from_world[2, :3]
            camera.up = -camera_from_world[1, :3]
            camera.frustum_center = 0.0
            camera.frustum_width = 0.0  # from the viewport's aspect
            camera.frustum_top, camera.frustum_bottom = self._near * tangent, -self._near * tangent
            camera.frustum_near, camera.frustum_far = self._near, self.far

    def _outside_frustum(
        self, data: mujoco.MjData, intrinsics: ndarray, camera_from_world: ndarray
    ) -> Bool[ndarray, "ngeom"]:
        """Tell which geoms' bounding spheres lie outside the view; drawing them would cost time and no pixel."""
        centre = data.geom_xpos @ camera_from_world[:3, :3].T + camera_from_world[:3, 3]
        radius = self._model.geom_rbound
        tangent = 0.5 * np.array([self._width, self._height]) / intrinsics[[0, 1], [0, 1]]
        beyond = np.abs(centre[:, :2]) - centre[:, 2:] * tangent  # distance to the side planes, up to the cosine
        sideways = (beyond > radius[:, None] * np.sqrt(1.0 + tangent**2)).any(1)
        return (radius > 0) & (sideways | (centre[:, 2] + radius < self._near))  # planes have no radius

    def _geom_of_segment(self) -> Int32[ndarray, "S"]:
        """Return the geom id of each colour of the label pass; colour 0 is the background, the n-th geom has n + 1."""
        table = np.full(65536, -1, np.int32)
        for geom in self._scene.geoms[: self._scene.ngeom]:
            if geom.segid >= 0 and geom.objtype == mujoco.mjtObj.mjOBJ_GEOM:
                table[geom.segid + 1] = geom.objid
        return table


class _OffscreenTarget:
    """An OpenGL context with an off-screen buffer, and the model's meshes and textures in it."""

    def __init__(self, model: mujoco.MjModel, height: int, width: int, shadow_map: int, samples: int):
        self.has_shadows = shadow_map > 0
        visual, size = model.vis, (model.vis.global_.offwidth, model.vis.global_.offheight)
        quality = (visual.quality.shadowsize, visual.quality.offsamples)
        visual.global_.offwidth, visual.global_.offheight = width, height
        visual.quality.shadowsize, visual.quality.offsamples = shadow_map, samples  # read when the context is made
        self._gl: mujoco.GLContext | None = mujoco.GLContext(width, height)
        self._gl.make_current()
        self.context = mujoco.MjrContext(model, mujoco.mjtFontScale.mjFONTSCALE_100)
        visual.global_.offwidth, visual.global_.offheight = size
        visual.quality.shadowsize, visual.quality.offsamples = quality
        mujoco.mjr_setBuffer(mujoco.mjtFramebuffer.mjFB_OFFSCREEN, self.context)
        self.context.readDepthMap = mujoco.mjtDepthMap.mjDEPTH_ZEROFAR  # keeps float precision far away

    def make_current(self) -> None:
        if self._gl is None:
            raise RuntimeError("the renderer is closed")
        self._gl.make_current()

    def close(self) -> None:
        if self._gl is not None:
            self._gl.make_current()
            self.context.free()
            self._gl.free()
            self._gl = None
