"""Multi-view rendering: RGB, depth and labels of one simulation state from many cameras, in few passes.

All views are tiles of one off-screen image, which is read back once; only if that would be larger than OpenGL allows do
they take turns. Depth comes out of the label pass, in which each geom has its own colour, colours out of a second one.
Sites are not drawn, since goal markers would give the goal away.
"""

import copy
import math
from typing import NamedTuple

import cv2
import mujoco
import numpy as np
from jaxtyping import Bool, Float, Int32, Shaped, UInt8
from numpy import ndarray

from nerf_rl.cameras.geometry import camera_position
from nerf_rl.errors import UserError
from nerf_rl.machine.gl import is_software, renderer_name
from nerf_rl.rendering.culling import FrustumCulling, faint_markers, planes_from_behind
from nerf_rl.rendering.level_of_detail import simplify_meshes
from nerf_rl.rendering.near_plane import near_plane
from nerf_rl.rendering.offscreen_target import OffscreenTarget
from nerf_rl.rendering.still_background import StillBackground, StillGeoms
from nerf_rl.rendering.uploads import Uploads
from nerf_rl.scenes.workspace import undrawn

_HIDDEN_GROUP = 5  # of geoms; not drawn by default
_FULL_SHADOW_MAP = 4096
_USUAL_PIXELS_PER_METRE = 1.0 / (2.0 * np.tan(np.deg2rad(22.5)) * 0.7)  # [1/m], times the image's height
_FULL_SAMPLES = 4
_HANGING_SEGMENTS = 50  # of a slack tendon, at most; MuJoCo 3.3 draws 28
_CRANK_PARTS = 3  # of an actuator's slider and crank
_SMOOTH_SIDE = 2  # pixels drawn, along each side, of one that is kept; half the time of multisampling in software


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
        model: the simulated model; all but its meshes is read from it at each call.
        height, width: of one view [pixels].
        views: the most cameras a call may have.
        quality: ``full`` (shadows, reflections, multisampling), ``plain`` (none of these), ``fast`` (as ``plain``,
            with meshes simplified for the images) or ``smooth`` (as ``fast``, with each pixel's colour the mean of
            four, and labels and depth as MuJoCo's rays find them: in a gap of a mesh they hit its inside, where
            OpenGL, which does not draw insides, shows what is behind the mesh).
        pixels_per_metre: in an image, where a camera is nearest to what it shows; decides how far meshes are
            simplified; none: as for a camera with a field of view of 45 degrees, 0.7 m away.
        colours_only: whether :meth:`render_rgb` is all that will be asked for; the other pass then takes no memory.

    Raises:
        UserError: a view is larger than OpenGL can draw.
    """

    def __init__(
        self,
        model: mujoco.MjModel,
        height: int,
        width: int,
        views: int,
        quality: str = "fast",
        pixels_per_metre: float | None = None,
        colours_only: bool = False,
    ):
        self._model, self._height, self._width, self._views = model, height, width, views
        usual = height * _USUAL_PIXELS_PER_METRE
        self.pixels_per_metre = usual if pixels_per_metre is None else pixels_per_metre
        simple = quality in ("fast", "smooth")
        drawn = simplify_meshes(model, height, self.pixels_per_metre) if simple else copy.deepcopy(model)
        targets = []
        if quality in ("plain", "fast") or not colours_only:
            targets.append(OffscreenTarget(drawn, height, width, views, shadow_map=0, samples=0))
        if quality == "full":
            targets.append(OffscreenTarget(drawn, height, width, views, _FULL_SHADOW_MAP, _FULL_SAMPLES))
        elif quality == "smooth":
            sides = _SMOOTH_SIDE * height, _SMOOTH_SIDE * width
            try:
                targets.append(OffscreenTarget(drawn, *sides, views, shadow_map=0, samples=0))
            except UserError as error:
                raise UserError(f"{error}; smooth pictures are drawn {_SMOOTH_SIDE} times as large") from error
        self._targets = targets  # of labels, unless none are asked for, and of colours, which may be the same
        self._uploads = Uploads(model, targets)
        self._at_once = min(target.tiles for target in targets)
        self._option = mujoco.MjvOption()
        self._option.sitegroup[:] = 0
        self._camera, self._perturb = mujoco.MjvCamera(), mujoco.MjvPerturb()
        self._scene = mujoco.MjvScene(model, maxgeom=_most_scene_geoms(model))
        led = model.body_mocapid[model.body_rootid[model.geom_bodyid]] >= 0  # by a mocap body, which may move
        self._planes = (model.geom_type == mujoco.mjtGeom.mjGEOM_PLANE) & ~led
        self._scene_geoms = self._scene.geoms  # making this tuple takes longer than reading what is in it
        self._near = near_plane(model)
        self.far = float(model.vis.map.zfar * model.stat.extent)
        self._culling = FrustumCulling(model, height, width, self._near)
        self._faint = faint_markers(model)
        self._labels_insides = quality == "smooth"
        colours = targets[-1]
        pixels = self._at_once * colours.height * colours.width
        self._rgb, self._buffer_depth = np.empty(3 * pixels, np.uint8), np.empty(pixels, np.float32)
        self._labels = None if colours_only else _Layer(targets[0], True, StillBackground())
        self._colours = _Layer(colours, False, None if colours.has_shadows else StillBackground())
        self._still_geoms = StillGeoms(model) if is_software(self.gl_renderer) else None  # a GPU draws all in no time

    @property
    def gl_renderer(self) -> str:
        """The OpenGL implementation's name for itself."""
        self._colours.target.make_current()
        return renderer_name()

    def render(
        self,
        data: mujoco.MjData,
        intrinsics: Float[ndarray, "V 3 3"],
        camera_from_world: Float[ndarray, "V 4 4"],
    ) -> Views:
        """Render colours, depth and geom ids.

        Args:
            data: the state, with positions propagated; :class:`RenderData` gives it at any time.
            intrinsics: K [pixels], with square pixels and a centred principal point.
            camera_from_world: poses.
        """
        turns = self._turns(intrinsics, camera_from_world)
        rendered = [self._render_at_once(data, *cameras) for cameras in turns]
        return rendered[0] if len(rendered) == 1 else Views(*map(np.concatenate, zip(*rendered, strict=True)))

    def render_rgb(
        self,
        data: mujoco.MjData,
        intrinsics: Float[ndarray, "V 3 3"],
        camera_from_world: Float[ndarray, "V 4 4"],
    ) -> UInt8[ndarray, "V H W 3"]:
        """Render colours alone, the same as in :meth:`render`."""
        turns = self._turns(intrinsics, camera_from_world)
        rendered = [self._rgb_at_once(data, *cameras, self._look(data, *cameras)) for cameras in turns]
        return rendered[0] if len(rendered) == 1 else np.concatenate(rendered)

    def close(self) -> None:
        """Free the OpenGL resources."""
        for target in self._targets:
            target.close()

    def _turns(
        self, intrinsics: Float[ndarray, "V 3 3"], camera_from_world: Float[ndarray, "V 4 4"]
    ) -> list[tuple[ndarray, ndarray]]:
        """Divide cameras into as many as are drawn at once."""
        count = len(intrinsics)
        if count > self._views:
            raise ValueError(f"this renderer was made for {self._views} views, got {count}")
        turns = [slice(first, first + self._at_once) for first in range(0, count, self._at_once)]
        return [(intrinsics[turn], camera_from_world[turn]) for turn in turns]

    def _look(self, data: mujoco.MjData, intrinsics: ndarray, camera_from_world: ndarray) -> Bool[ndarray, "V G"]:
        """Take in what is to be drawn; return which geoms no view needs, since they are outside of it."""
        painted = self._uploads.refresh(data)
        if self._still_geoms is not None:
            if painted:
                self._still_geoms.forget()
            self._still_geoms.look(data, intrinsics, camera_from_world)
        return self._culling.outside(data, intrinsics, camera_from_world)

    def _render_at_once(self, data: mujoco.MjData, intrinsics: ndarray, camera_from_world: ndarray) -> Views:
        if self._labels is None:
            raise ValueError("this renderer was made for colours alone")
        hidden = self._look(data, intrinsics, camera_from_world)
        unlabelled = hidden | self._faint
        if self._labels_insides:  # a plane has no inside, but would be drawn from behind as well
            unlabelled = unlabelled | planes_from_behind(self._model, data, camera_from_world)
        labelled = self._picture(self._labels, data, intrinsics, camera_from_world, unlabelled)
        labels, buffer = _upright(labelled.pixels), _upright(labelled.depth)
        depth = self._near * self.far / (self._near + buffer * (self.far - self._near))
        covered = None
        if self._labels.target is self._colours.target:  # pixels have the colours of what they are labelled
            covered = labelled.opaque[:, None] & ~_shown(labels, self._model.ngeom) & ~self._faint
        rgb = self._rgb_at_once(data, intrinsics, camera_from_world, hidden, covered)
        return Views(rgb, depth.astype(np.float32), labels)

    def _rgb_at_once(
        self,
        data: mujoco.MjData,
        intrinsics: ndarray,
        camera_from_world: ndarray,
        hidden: Bool[ndarray, "V G"],
        covered: Bool[ndarray, "V G"] | None = None,
    ) -> UInt8[ndarray, "V H W 3"]:
        if self._colours.target.has_shadows:  # what a camera does not see may cast a shadow into its view
            hidden = np.broadcast_to(undrawn(self._model), hidden.shape)
        pixels = self._picture(self._colours, data, intrinsics, camera_from_world, hidden, covered).pixels
        if pixels.shape[2] == self._width:
            return _upright(pixels).copy()
        flat = pixels.reshape(-1, *pixels.shape[2:])
        kept = cv2.resize(flat, (self._width, len(pixels) * self._height), interpolation=cv2.INTER_AREA)
        return _upright(kept.reshape(len(pixels), self._height, self._width, 3)).copy()

    def _picture(
        self,
        layer: "_Layer",
        data: mujoco.MjData,
        intrinsics: ndarray,
        camera_from_world: ndarray,
        hidden: Bool[ndarray, "V G"],
        covered: Bool[ndarray, "V G"] | None = None,
    ) -> "_Picture":
        """Return what all views show; of what stands still before cameras that do, a picture is kept.

        Args:
            layer: colours or labels.
            data: the state.
            intrinsics, camera_from_world: of the views.
            hidden: geoms that are not drawn.
            covered: geoms that are not drawn either, in this state.
        """
        cameras, needless = (intrinsics, camera_from_world), hidden if covered is None else hidden | covered
        still, background = self._still_geoms, layer.background
        if still is None or background is None or not still.steady.any():
            return self._draw(layer, data, *cameras, needless)
        steady = [int(view) for view in np.flatnonzero(still.steady)]
        missing = [view for view in steady if not background.has(view, still.key(view))]
        if missing:
            moving = hidden[missing] | ~still.still
            picture = self._draw(layer, data, intrinsics[missing], camera_from_world[missing], moving)
            for view, pixels, depth in zip(missing, picture.pixels, picture.depth, strict=True):
                background.keep(view, still.key(view), pixels, depth)
        kept = still.steady[:, None] & still.still
        picture = self._draw(layer, data, *cameras, needless | kept, has_sky=~still.steady)
        if all(background.put_behind(view, picture.pixels[view], picture.depth[view]) for view in steady):
            return picture
        return self._draw(layer, data, *cameras, needless)

    def _draw(
        self,
        layer: "_Layer",
        data: mujoco.MjData,
        intrinsics: ndarray,
        camera_from_world: ndarray,
        hidden: Bool[ndarray, "V G"],
        has_sky: Bool[ndarray, "V"] | None = None,
    ) -> "_Picture":
        """Draw all views without the geoms hidden from them, into buffers that the next call overwrites."""
        target, count = layer.target, len(intrinsics)
        target.make_current()
        flags = self._scene.flags
        flags[mujoco.mjtRndFlag.mjRND_SHADOW] = flags[mujoco.mjtRndFlag.mjRND_REFLECTION] = target.has_shadows
        flags[mujoco.mjtRndFlag.mjRND_SEGMENT] = flags[mujoco.mjtRndFlag.mjRND_IDCOLOR] = layer.labels
        flags[mujoco.mjtRndFlag.mjRND_CULL_FACE] = not (layer.labels and self._labels_insides)
        drawn = []
        for view in range(count):
            flags[mujoco.mjtRndFlag.mjRND_SKYBOX] = has_sky is None or has_sky[view]
            self._update_scene(data, intrinsics[view], camera_from_world[view], hidden[view])
            tile = mujoco.MjrRect(0, view * target.height, target.width, target.height)
            mujoco.mjr_render(tile, self._scene, target.context)
            if layer.labels:
                drawn.append(self._drawn_geoms())

        size = (count, target.height, target.width)
        colours = self._rgb[: 3 * math.prod(size)].reshape(*size, 3)
        depth = self._buffer_depth[: math.prod(size)].reshape(size)
        rows, read = mujoco.MjrRect(0, 0, target.width, count * target.height), colours.reshape(-1, target.width, 3)
        needs_depth = layer.labels or (self._still_geoms is not None and layer.background is not None)
        buffer = depth.reshape(-1, target.width) if needs_depth else None
        mujoco.mjr_readPixels(read, buffer, rows, target.context)
        if not layer.labels:
            return _Picture(colours, depth, np.ones(count, bool))
        segment = colours[..., 0].astype(np.int32) | colours[..., 1].astype(np.int32) << 8
        labels = np.stack([view.geom_of_segment[ids] for view, ids in zip(drawn, segment, strict=True)])
        return _Picture(labels, depth, np.array([view.opaque for view in drawn]))

    def _update_scene(
        self, data: mujoco.MjData, intrinsics: ndarray, camera_from_world: ndarray, hidden: Bool[ndarray, "G"]
    ) -> None:
        """Fill the scene with all but the hidden geoms, and set the camera.

        Geoms are drawn in the scene's order, so planes come last: most of a floor is covered by what stands on it. They
        are put in as what stands still, since tendons, cloth and the like would come with them a second time.
        """
        model, planes = self._model, self._planes & ~hidden
        everything, still = mujoco.mjtCatBit.mjCAT_ALL.value, mujoco.mjtCatBit.mjCAT_STATIC.value
        groups = model.geom_group.copy()
        try:  # groups are how to leave geoms out of a scene; nothing else reads them meanwhile
            model.geom_group[hidden | planes] = _HIDDEN_GROUP
            mujoco.mjv_updateScene(model, data, self._option, None, self._camera, everything, self._scene)
            if planes.any():
                model.geom_group[:] = np.where(planes, groups, _HIDDEN_GROUP)
                mujoco.mjv_addGeoms(model, data, self._option, self._perturb, still, self._scene)
        finally:
            model.geom_group[:] = groups
        tangent = 0.5 * self._height / intrinsics[1, 1]
        for camera in self._scene.camera:
            camera.pos = camera_position(camera_from_world)
            camera.forward = camera_from_world[2, :3]
            camera.up = -camera_from_world[1, :3]
            camera.orthographic = 0  # the model may ask for it
            camera.frustum_center = 0.0
            camera.frustum_width = 0.0  # from the viewport's aspect
            camera.frustum_top, camera.frustum_bottom = self._near * tangent, -self._near * tangent
            camera.frustum_near, camera.frustum_far = self._near, self.far

    def _drawn_geoms(self) -> "_DrawnGeoms":
        """Describe what is in the scene."""
        geom_of_segment, opaque = np.full(len(self._scene_geoms) + 1, -1, np.int32), True
        for geom in self._scene_geoms[: self._scene.ngeom]:
            opaque = opaque and geom.rgba[3] >= 1
            if geom.segid >= 0 and geom.objtype == mujoco.mjtObj.mjOBJ_GEOM:
                geom_of_segment[geom.segid + 1] = geom.objid
        return _DrawnGeoms(geom_of_segment, opaque)


class _Layer(NamedTuple):
    """One of the two passes."""

    target: OffscreenTarget
    """where it is drawn"""
    labels: bool
    """whether each geom has a colour of its own"""
    background: StillBackground | None
    """of what stands still; none: all is drawn each time"""


class _Picture(NamedTuple):
    """What several views show, as OpenGL has it: from the bottom row up."""

    pixels: Shaped[ndarray, "V H W *C"]
    """colours (uint8), or geom ids (int32; -1 where no geom is hit)"""
    depth: Float[ndarray, "V H W"]
    """of the depth buffer: greater is nearer, and 0 where nothing is hit; undefined for colours without background"""
    opaque: Bool[ndarray, "V"]
    """of labels: whether nothing shows through anything, so that what has no label has no colour either"""


class _DrawnGeoms(NamedTuple):
    """What was drawn into one view."""

    geom_of_segment: Int32[ndarray, "S"]
    """geom id of each colour of the label pass; colour 0 is the background, the n-th geom has n + 1"""
    opaque: bool
    """whether nothing shows through anything, so that what has no label has no colour either"""


def _most_scene_geoms(model: mujoco.MjModel) -> int:
    """Return how many geoms a scene may come to hold; MuJoCo leaves out the last if they are more, planes above all."""
    tendons = 2 * model.nwrap + _HANGING_SEGMENTS * model.ntendon
    others = tendons + _CRANK_PARTS * model.nu + model.nsensordata + model.nflex + model.nskin
    return int(model.ngeom + 1000 + others)


def _upright(views: Shaped[ndarray, "V H W *C"]) -> Shaped[ndarray, "V H W *C"]:
    """Return views with their top row first."""
    return views[:, ::-1]


def _shown(labels: Int32[ndarray, "V H W"], geoms: int) -> Bool[ndarray, "V geoms"]:
    """Tell which geoms have a pixel in each view."""
    first = np.arange(len(labels), dtype=np.int32)[:, None, None] * (geoms + 1)
    counts = np.bincount((labels + 1 + first).ravel(), minlength=len(labels) * (geoms + 1))
    return counts.reshape(len(labels), geoms + 1)[:, 1:] > 0
