"""``nerf-rl view DATASET``: the page."""

import threading
import time
from collections.abc import Callable
from typing import Protocol

import viser

from nerf_rl.datasets.storage.frames import EpisodeColumns, Frame, read_columns, read_frame
from nerf_rl.datasets.storage.reader import MultiViewDataset
from nerf_rl.datasets.storage.stored_manifest import DEPTH, LABELS, STATE
from nerf_rl.viewer.drawing.charts import statistics_charts
from nerf_rl.viewer.drawing.pictures import camera_strip, depth_scale, legend
from nerf_rl.viewer.drawing.statistics import sample_statistics
from nerf_rl.viewer.newest import NewestOnly
from nerf_rl.viewer.panels.camera_panel import CameraPanel
from nerf_rl.viewer.panels.columns_panel import ColumnsPanel
from nerf_rl.viewer.panels.scene_panel import ScenePanel
from nerf_rl.viewer.panels.timeline_panel import TimelinePanel
from nerf_rl.viewer.timeline import Timeline

_SCENE_PAUSE = 0.4  # [s] between two changes of the 3-D scene, which a browser without a GPU takes long to draw

_STATISTICS_PAUSE = 2.0  # [s] for the first pictures to arrive before anything else is worked out


class Companion(Protocol):
    """What stands beside the dataset, such as an encoder's field."""

    def show(self, frame: Frame, stale: Callable[[], bool]) -> None:
        """Draw a frame; may stop early when ``stale`` says that a newer one is waiting."""
        ...


class DatasetView:
    """The page of a dataset.

    Args:
        server: to build it on.
        dataset: to show.
    """

    def __init__(self, server: viser.ViserServer, dataset: MultiViewDataset):
        self.server, self.dataset = server, dataset
        self.companions: list[Companion] = []
        self._columns: tuple[range, EpisodeColumns] | None = None
        self._connected = threading.Event()
        server.on_client_connect(lambda _: self._connected.set())
        self._worker: NewestOnly[int] = NewestOnly(self._show)
        self._scene_worker: NewestOnly[Frame] = NewestOnly(lambda frame, _: self.scene.show(frame), _SCENE_PAUSE)
        timeline = Timeline(dataset)
        first = read_frame(dataset, 0)
        gui = server.gui
        self.timeline = TimelinePanel(gui, timeline, self._worker.order, self._worker.wait)
        self._timeline = timeline
        self.status = gui.add_markdown("")
        with gui.add_folder("3-D scene"):
            self.scene = ScenePanel(server, dataset, first, self.redraw)
        panel = gui.add_panel()
        with panel.add_tab("Cameras", viser.Icon.CAMERA):
            if LABELS not in dataset.absent:
                gui.add_html(legend(dataset.class_names, dataset.palette))
            if DEPTH not in dataset.absent:
                gui.add_image(depth_scale(self.scene.depth_range), format="png")
            self.cameras = CameraPanel(gui, dict(enumerate(dataset.camera_names)), self._strip)
        self.columns: ColumnsPanel | None = None
        if columns := list(read_columns(dataset, range(1)).columns):
            with panel.add_tab("Episode", viser.Icon.CHART_LINE):
                self.columns = ColumnsPanel(gui, columns)
        is_told = not {LABELS, STATE} <= set(dataset.absent)
        self.statistics_tab = panel.add_tab("Dataset", viser.Icon.CHART_BAR) if is_told else None
        self.panel = panel
        panel.dock_left()
        panel.set_width(430)
        self._worker.order(0)

    def redraw(self) -> None:
        """Draw the present frame again."""
        self._worker.order(self.timeline.index)

    def gather_statistics(self) -> None:
        """Draw the dataset's statistics once a page has its first pictures, in a thread of their own."""
        tab = self.statistics_tab
        if tab is None:
            return

        def gather() -> None:
            self._connected.wait()
            time.sleep(_STATISTICS_PAUSE)
            charts = statistics_charts(sample_statistics(self.dataset), self.dataset.palette)
            with tab:
                for chart in charts:
                    self.server.gui.add_image(chart, format="png")

        threading.Thread(target=gather, daemon=True).start()

    def close(self) -> None:
        """End the threads."""
        self.timeline.close()
        self._worker.close()
        self._scene_worker.close()

    def _show(self, index: int, stale: Callable[[], bool]) -> None:
        frame = read_frame(self.dataset, index)
        self._scene_worker.order(frame)
        self.cameras.show(frame)
        if self.columns is not None:
            frames = self._timeline.frames(frame.episode)
            if self._columns is None or self._columns[0] != frames:
                self._columns = frames, read_columns(self.dataset, frames)
            self.columns.show(self._columns[1], index - frames.start)
        outcome = ", success" if frame.success else ""  # whether a scene tells of it at all is not stored
        self.status.content = (
            f"frame **{index}** of {len(self.dataset)}, episode **{frame.episode}**, "
            f"step **{frame.step}**, {frame.split}{outcome}"
        )
        for companion in self.companions:
            companion.show(frame, stale)

    def _strip(self, frame: Frame, view: int):  # type: ignore[no-untyped-def]
        return camera_strip(frame, view, self.dataset.palette, self.scene.depth_range)
