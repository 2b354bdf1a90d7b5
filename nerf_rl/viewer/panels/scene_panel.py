"""The 3-D scene in the browser: camera frusta with their images, a fused point cloud, axes and named positions."""

from collections.abc import Callable

import numpy as np
import viser
from jaxtyping import Float
from numpy import ndarray

from nerf_rl.cameras.geometry import camera_position
from nerf_rl.datasets.storage.frames import Frame
from nerf_rl.datasets.storage.point_cloud import COLOURINGS, PointCloud, fuse_views
from nerf_rl.datasets.storage.reader import MultiViewDataset
from nerf_rl.datasets.storage.stored_manifest import DEPTH, LABELS
from nerf_rl.errors import UserError
from nerf_rl.pictures.images import is_surface
from nerf_rl.pretrain.data.looked_at import distances_to_what_is_looked_at
from nerf_rl.viewer.drawing.pictures import depth_limits
from nerf_rl.viewer.node_names import node_name
from nerf_rl.viewer.panels.frusta import add_frustum, frustum_pose

_POINT_SIZE = 0.005  # [m]


class ScenePanel:
    """Shows frames in three dimensions.

    Args:
        server: to draw on.
        dataset: the frames' cameras, classes and palette.
        first: a frame that decides the view and the colours of depth.
        changed: called when a control asks for the frame to be drawn again.
    """

    def __init__(self, server: viser.ViserServer, dataset: MultiViewDataset, first: Frame, changed: Callable[[], None]):
        self._server, self._dataset = server, dataset
        self.depth_range = depth_limits(first)
        self._frusta: list[viser.CameraFrustumHandle] = []
        self._names: list[viser.LabelHandle] = []
        self._points: dict[str, viser.IcosphereHandle] = {}
        self._labels: dict[str, viser.LabelHandle] = {}
        self._cloud: viser.PointCloudHandle | None = None
        gui = server.gui
        colourings = _colourings(dataset.absent)
        first_colouring = "RGB" if colourings else "hidden"
        self.colouring = gui.add_dropdown("Point cloud", ("hidden", *colourings), initial_value=first_colouring)
        self.reach = gui.add_slider("Reach [m]", 0.2, 5.0, 0.1, 2.5, hint="points farther from their camera are hidden")
        self.size = gui.add_slider("Point size [mm]", 1, 20, 0.5, 1000 * _POINT_SIZE)
        shown = gui.add_checkbox("Cameras", True)
        with gui.add_folder("Classes in the point cloud", expand_by_default=False):
            self.classes = [gui.add_checkbox(name, True) for name in dataset.class_names]
        shown.on_update(lambda _: self._show_frusta(shown.value))
        for control in (self.colouring, self.reach, *self.classes):
            control.on_update(lambda _: changed())
        self.size.on_update(lambda _: self._resize())
        server.scene.add_frame("/world", axes_length=0.2, axes_radius=0.004)
        server.scene.add_label("/world/name", "world", position=(0.0, 0.0, -0.02))
        look_from(server, first)

    def cloud(self, frame: Frame) -> PointCloud:
        """Return the point cloud that the controls ask for."""
        return fuse_views(
            frame,
            self.colouring.value,
            self._dataset.palette,
            self.depth_range,
            [i for i, box in enumerate(self.classes) if box.value],
            self.reach.value,
        )

    def show(self, frame: Frame) -> None:
        """Draw a frame."""
        if not self._frusta:
            self._add_frusta(frame)
        for view, frustum in enumerate(self._frusta):
            frustum.image = frame.rgb[view]
            wxyz, place = frustum_pose(frame.camera_from_world[view])
            if not (np.array_equal(wxyz, frustum.wxyz) and np.array_equal(place, frustum.position)):
                frustum.wxyz, frustum.position = wxyz, place
                self._names[view].position = place
        self._show_cloud(frame)
        for i, (name, position) in enumerate(frame.points.items()):
            if name not in self._points:
                colour = [(240, 60, 60), (60, 160, 60), (200, 160, 0), (140, 60, 200)][i % 4]
                self._points[name] = self._server.scene.add_icosphere(
                    node_name("points", name), radius=0.008, color=colour
                )
                self._labels[name] = self._server.scene.add_label(node_name("point names", name), name)
            self._points[name].position = self._labels[name].position = position

    def _show_cloud(self, frame: Frame) -> None:
        if self.colouring.value == "hidden":
            if self._cloud is not None:
                self._cloud.visible = False
            return
        cloud = self.cloud(frame)
        if self._cloud is None:
            self._cloud = self._server.scene.add_point_cloud(
                "/cloud", cloud.points, cloud.colours, point_size=self.size.value / 1000, point_shape="circle"
            )
            return
        with self._server.atomic():
            self._cloud.points, self._cloud.colors = cloud.points, cloud.colours
            self._cloud.visible = True

    def _add_frusta(self, frame: Frame) -> None:
        for view, camera in enumerate(self._dataset.manifest["cameras"]):
            seen = frame.intrinsics[view], frame.camera_from_world[view], frame.rgb[view]
            self._frusta.append(add_frustum(self._server, camera["name"], camera["role"], *seen))
            label = self._server.scene.add_label(node_name("camera names", camera["name"]), camera["name"])
            label.position = self._frusta[view].position
            self._names.append(label)

    def _show_frusta(self, visible: bool) -> None:
        for node in (*self._frusta, *self._names):
            node.visible = visible

    def _resize(self) -> None:
        if self._cloud is not None:
            self._cloud.point_size = self.size.value / 1000


def _colourings(absent: tuple[str, ...]) -> list[str]:
    """Return what the points of a dataset may be coloured by; without depth there are none."""
    known = [name for name in COLOURINGS if name != "semantic" or LABELS not in absent]
    return [] if DEPTH in absent else known


def look_from(server: viser.ViserServer, frame: Frame) -> None:
    """Begin between the first camera and the others, farther off, with a view of what most of them look at."""
    centres = camera_position(frame.camera_from_world)
    forward = frame.camera_from_world[:, 2, :3]
    distance = _distance_to_what_is_seen(frame)
    seen = ~np.isnan(distance)  # the others look at nothing
    if not seen.any():
        return
    target = np.mean(centres[seen] + forward[seen] * distance[seen, None], axis=0)
    away = 0.7 * centres[0] + 0.3 * np.mean(centres, axis=0) - target
    server.initial_camera.position = target + 1.6 * away + np.array([0.0, 0.0, 0.3])
    server.initial_camera.look_at = target


def _distance_to_what_is_seen(frame: Frame) -> Float[ndarray, "V"]:
    """Return the planar depth [m] of what most of each picture shows, not a number where that is unknown."""
    if DEPTH in frame.absent:
        try:
            return distances_to_what_is_looked_at(frame.camera_from_world[None])[0]
        except UserError:  # they look in one direction, or away from each other
            return np.full(len(frame.camera_from_world), np.nan)
    depth = np.where(is_surface(frame.depth, frame.far), frame.depth, np.nan).reshape(len(frame.depth), -1)
    distance = np.full(len(depth), np.nan)
    seen = ~np.isnan(depth).all(axis=1)
    distance[seen] = np.nanmedian(depth[seen], axis=1)
    return distance
