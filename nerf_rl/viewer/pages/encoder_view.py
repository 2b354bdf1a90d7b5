"""``nerf-rl view ENCODER``: the dataset's page, with what the radiance field renders from each latent."""

import html
import threading
from collections.abc import Callable

import torch
import viser
from torch import Tensor

from nerf_rl.datasets.storage.frames import Frame, read_frame
from nerf_rl.viewer.field.field_panel import FieldPanel
from nerf_rl.viewer.field.latents import EncodedDataset, Probe
from nerf_rl.viewer.field.reconstruction import comparison, render_views
from nerf_rl.viewer.pages.dataset_view import DatasetView


class EncoderPanel:
    """The companion that decodes each frame's latent.

    Args:
        page: the dataset's page, to stand beside.
        encoded: the dataset through the encoder.
    """

    def __init__(self, page: DatasetView, encoded: EncodedDataset):
        self._page, self._encoded = page, encoded
        self._frame: Frame | None = None
        self._latent: Tensor | None = None
        self._ends: dict[str, tuple[int, Tensor]] = {}
        self._probe: Probe | None = None
        self._images: dict[int, viser.GuiImageHandle] = {}
        self._depth_range = encoded.depth_limits(read_frame(page.dataset, 0))
        gui = page.server.gui
        with gui.add_folder("Radiance field"):
            self.field = FieldPanel(page.server, encoded.palette, self._depth_range)
        with gui.add_folder("Between two frames"):
            ends = gui.add_button_group("This frame is", ("start", "end"))
            self.share = gui.add_slider("From start to end", 0.0, 1.0, 0.02, 0.0)
            self.between = gui.add_markdown("Choose a start and an end.")
        with page.panel.add_tab("From z", viser.Icon.CUBE):
            gui.add_markdown("Rows: what the camera saw, what the field renders from z, the error.")
            self._tab = gui.add_folder("Decoded cameras")
        with page.panel.add_tab("Probe", viser.Icon.TARGET):
            self.table = gui.add_html("<p style='padding:.8em'>fitting a linear probe ...</p>")
        ends.on_click(lambda event: self._choose_end(event.target.value))
        self.share.on_update(lambda _: self._show_between())
        page.scene.colouring.value = "hidden"
        page.companions.append(self)
        threading.Thread(target=self._fit_probe, daemon=True).start()

    def show(self, frame: Frame, stale: Callable[[], bool]) -> None:
        """Decode a frame."""
        self._frame, self._latent = frame, self._encoded.latent(frame)
        folded = self._encoded.folded(self._latent)
        self.field.show(folded)
        self._show_probe()
        for view, name in enumerate(self._page.dataset.camera_names):
            rendered = render_views(folded, *frame.cameras([view]), stale)
            if rendered is None:
                return
            limits, far = self._depth_range, self._encoded.field.bounds.far
            picture = comparison(frame, view, rendered[0], self._page.dataset.palette, limits, far)
            if view in self._images:
                self._images[view].image = picture
                continue
            with self._tab:
                self._images[view] = self._page.server.gui.add_image(picture, label=name, format="jpeg")

    def close(self) -> None:
        """End the threads."""
        self.field.close()

    def _choose_end(self, which: str) -> None:
        if self._frame is None or self._latent is None:
            return
        self._ends[which] = self._frame.index, self._latent
        chosen = ", ".join(f"{name}: frame {index}" for name, (index, _) in sorted(self._ends.items(), reverse=True))
        self.between.content = chosen
        self._show_between()

    def _show_between(self) -> None:
        if len(self._ends) == 2:
            latent = torch.lerp(self._ends["start"][1], self._ends["end"][1], self.share.value)
            self.field.show(self._encoded.folded(latent))

    def _fit_probe(self) -> None:
        self._probe = self._encoded.fit_probe()
        self._show_probe()

    def _show_probe(self) -> None:
        if self._probe is None or self._frame is None or self._latent is None:
            return
        truth = {
            f"{name}_{axis}": value
            for name, place in self._frame.points.items()
            for axis, value in zip("xyz", place, strict=True)
        }
        self.table.content = probe_table(self._probe.read(self._latent), truth)


def probe_table(read: dict[str, float], truth: dict[str, float]) -> str:
    """Return HTML with what a probe read beside the truth [mm]."""
    style = "style='text-align:right;padding-left:1em'"
    rows = ""
    for name, value in read.items():
        if name in truth:
            metres = value, truth[name], value - truth[name]
            cells = (f"<td {style}>{1000 * number:.1f}</td>" for number in metres)
            rows += f"<tr><td>{html.escape(name)}</td>{''.join(cells)}</tr>"
    head = "".join(f"<th {style}>{title}</th>" for title in ("probe", "true", "error"))
    return f"<table style='margin:.8em;font-size:.85em'><tr><th>[mm]</th>{head}</tr>{rows}</table>"
