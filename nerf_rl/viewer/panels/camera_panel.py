"""What each camera saw, in a panel at the side of the page."""

import viser

from nerf_rl.datasets.storage.frames import Frame
from nerf_rl.viewer.drawing.slides import Picture


class CameraPanel:
    """A picture for each camera.

    Args:
        gui: where to put them; the current container is used.
        names: of the cameras, by the position on the view axis.
        draw: makes a camera's picture.
    """

    def __init__(self, gui: viser.GuiApi, names: dict[int, str], draw: Picture):
        self._gui, self._names, self._draw = gui, names, draw
        self._container = gui.add_folder("Cameras")
        self._images: dict[int, viser.GuiImageHandle] = {}

    def show(self, frame: Frame) -> None:
        """Draw a frame."""
        for view, name in self._names.items():
            picture = self._draw(frame, view)
            if view in self._images:
                self._images[view].image = picture
                continue
            with self._container:
                self._images[view] = self._gui.add_image(picture, label=name, format="jpeg", jpeg_quality=90)
