"""The radiance field in the browser: a free camera that renders it as it moves, and its density as a mesh."""

import time
from collections.abc import Callable

import numpy as np
import trimesh
import viser
import viser.transforms as vtf
from jaxtyping import UInt8
from numpy import ndarray

from nerf_rl.pictures.images import colour_depth, colour_labels
from nerf_rl.pretrain.model.conditioned_field import ConditionedField
from nerf_rl.pretrain.model.ray_rendering import RenderedImages
from nerf_rl.viewer.field.density_mesh import density_mesh
from nerf_rl.viewer.field.progressive import FreeCamera, Picture, render_progressively
from nerf_rl.viewer.newest import NewestOnly

FIELD_MODES = ("RGB", "semantic", "depth", "density mesh", "off")
_COARSE = 24  # pixels on the longer side of the first picture
_MOVING = 128  # pixels on the longer side while the camera moves
_PATIENCE = 1.5  # the moving camera's picture may take so long before a newer one cancels it [s]


class Pace:
    """Chooses how many samples a ray gets while the camera moves: as many as keep the pictures coming.

    A machine that is slow, or busy with drawing the browser's page, gets grainier pictures instead of fewer.

    Attributes:
        samples: on each ray of the next picture.
    """

    FEWEST, MOST = 2, 6
    QUICK, SLOW = 0.2, 0.35
    """a picture that took less or more than so long asks for another number of samples [s]"""

    def __init__(self) -> None:
        self.samples = 4

    def took(self, seconds: float) -> None:
        """Learn how long a picture took."""
        change = int(seconds < self.QUICK) - int(seconds > self.SLOW)
        self.samples = min(max(self.samples + change, self.FEWEST), self.MOST)


class FieldPanel:
    """Renders a field for every browser that looks.

    Args:
        server: to draw on.
        palette: colours of the classes.
        depth_range: limits of depth's colours [m].

    Attributes:
        depth_range: of the pictures from now on.
    """

    def __init__(self, server: viser.ViserServer, palette: UInt8[ndarray, "C 3"], depth_range: tuple[float, float]):
        self._server, self._palette, self.depth_range = server, palette, depth_range
        self._field: ConditionedField | None = None
        self._workers: dict[int, NewestOnly[None]] = {}
        self._mesh: viser.GlbHandle | None = None
        self._mesh_worker: NewestOnly[None] = NewestOnly(self._draw_mesh)
        gui = server.gui
        self.mode = gui.add_dropdown("Field", FIELD_MODES, initial_value="RGB")
        self.finest = gui.add_slider("Pixels at rest", 64, 512, 64, 256)
        self.level = gui.add_slider("Density [1/m]", 2, 60, 1, 20, hint="of the mesh's surface")
        self.speed = gui.add_markdown("")
        self.mode.on_update(lambda _: self.redraw())
        self.finest.on_update(lambda _: self.redraw())
        self.level.on_update(lambda _: self.redraw())
        server.on_client_connect(self._welcome)
        server.on_client_disconnect(self._part)

    def show(self, field: ConditionedField) -> None:
        """Render another scene from now on."""
        self._field = field
        self.redraw()

    def redraw(self) -> None:
        """Draw again what every browser sees."""
        for worker in list(self._workers.values()):
            worker.order(None)
        self._mesh_worker.order(None)

    def close(self) -> None:
        """End the threads."""
        for worker in [*self._workers.values(), self._mesh_worker]:
            worker.close()

    def _welcome(self, client: viser.ClientHandle) -> None:
        pace = Pace()
        worker: NewestOnly[None] = NewestOnly(lambda _, stale: self._render(client, pace, stale))
        self._workers[client.client_id] = worker
        client.camera.on_update(lambda _: worker.order(None))
        worker.order(None)

    def _part(self, client: viser.ClientHandle) -> None:
        worker = self._workers.pop(client.client_id, None)
        if worker is not None:
            worker.close()

    def _render(self, client: viser.ClientHandle, pace: Pace, stale: Callable[[], bool]) -> None:
        mode, field = self.mode.value, self._field
        if field is None or mode in ("off", "density mesh"):
            client.scene.set_background_image(None)
            return
        start, moving_drawn = time.monotonic(), False

        def cancelled() -> bool:
            return stale() and (moving_drawn or time.monotonic() - start > _PATIENCE)

        fine = [Picture(_MOVING, pace.samples), Picture(max(_MOVING, int(self.finest.value)))]
        for number, images in enumerate(
            render_progressively(field, free_camera(client.camera), _COARSE, fine, cancelled)
        ):
            if client.client_id not in self._workers:
                return  # its page has been closed meanwhile
            if number > 0 or not stale():  # a moving camera is better off with the finer one of the next moment
                picture = picture_of(images, mode, self._palette, self.depth_range)
                client.scene.set_background_image(picture, format="jpeg", jpeg_quality=90, depth=images.depth[0])
            if number == 1:
                seconds = time.monotonic() - start
                self.speed.content = f"{_MOVING} pixels, {pace.samples} samples a ray, in {1000 * seconds:.0f} ms"
                pace.took(seconds)
                moving_drawn = True
            if number >= 1 and stale():
                return

    def _draw_mesh(self, _: None, stale: Callable[[], bool]) -> None:
        field = self._field
        if field is None or self.mode.value != "density mesh":
            if self._mesh is not None:
                self._mesh.visible = False
            return
        vertices, faces, colours = density_mesh(field, float(self.level.value))
        if stale():
            return
        if not len(faces):  # what is shown would be another level's, or another moment's
            if self._mesh is not None:
                self._mesh.visible = False
            return
        shades = (255 * colours).astype(np.uint8)
        surface = trimesh.Trimesh(vertices, faces, vertex_colors=shades, process=False)
        self._mesh = self._server.scene.add_mesh_trimesh("/density", surface)


def free_camera(camera: viser.CameraHandle) -> FreeCamera:
    """Return the camera of a browser."""
    world_from_camera = vtf.SE3.from_rotation_and_translation(vtf.SO3(camera.wxyz), camera.position)
    return FreeCamera(world_from_camera.inverse().as_matrix(), camera.fov, camera.aspect)


def picture_of(
    images: RenderedImages, mode: str, palette: UInt8[ndarray, "C 3"], depth_range: tuple[float, float]
) -> UInt8[ndarray, "H W 3"]:
    """Return the first view's colours, labels or depth."""
    if mode == "semantic":
        return colour_labels(images.semantic[0], palette)
    if mode == "depth":
        return colour_depth(images.depth[0], *depth_range)
    return (255 * images.rgb[0]).round().astype(np.uint8)
