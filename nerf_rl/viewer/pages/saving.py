"""Slides as files that need neither a browser's server nor a display: a page, a contact sheet, a video."""

from collections.abc import Callable, Sequence
from pathlib import Path

import cv2
import numpy as np
from jaxtyping import UInt8
from numpy import ndarray

from nerf_rl.datasets.storage.frames import read_frame
from nerf_rl.datasets.storage.reader import MultiViewDataset
from nerf_rl.files.atomic import atomic_write, write_text
from nerf_rl.files.outputs import making
from nerf_rl.pictures.page import Page
from nerf_rl.pictures.video import write_mp4
from nerf_rl.progress import Progress
from nerf_rl.viewer.drawing.slides import DrawSlide, Slide, evenly_chosen, in_columns

_ON_A_SHEET = 6
_FRAMES_PER_SECOND = 8.0

Charts = Callable[[], Sequence[UInt8[ndarray, "_ _ 3"]]]
"""Charts to stand below the slides of a page; drawn when they are needed."""


def save(
    files: dict[str, Path],
    title: str,
    slides: Sequence[DrawSlide],
    legend: tuple[Sequence[str], UInt8[ndarray, "C 3"]] | None,
    charts: Charts,
    scene: Callable[[], str] | None = None,
) -> None:
    """Write the files asked for and print their names.

    Args:
        files: where to, by ``save`` (page), ``png`` (contact sheet) and ``mp4`` (video).
        title: of the page.
        slides: what to show; each is drawn at most once, and those that no file needs are not.
        legend: names and colours of the classes; None without labels.
        charts: for the page.
        scene: makes a 3-D recording for the page, a document of its own.

    Raises:
        UserError: a file cannot be written, or its folder not be made, which is tried before anything is drawn.
    """
    for path in files.values():
        with making(path):
            path.parent.mkdir(parents=True, exist_ok=True)
    on_sheet = evenly_chosen(len(slides), _ON_A_SHEET)
    places = on_sheet if files.keys() == {"png"} else list(range(len(slides)))
    drawn = {}
    with Progress(len(places), "pictures") as progress:
        for place in places:
            drawn[place] = slides[place]()
            progress.advance()
    shown = list(drawn.values())
    for kind, path in files.items():
        with making(path):
            if kind == "png":
                _write_png(path, _contact_sheet([drawn[place].picture for place in on_sheet]))
            elif kind == "mp4":
                write_mp4(path, same_size([slide.picture for slide in shown]), _FRAMES_PER_SECOND)
            else:
                _write_page(path, title, shown, legend, charts(), scene)
        print(f"wrote {path}", flush=True)


def same_size(pictures: Sequence[UInt8[ndarray, "_ _ 3"]]) -> UInt8[ndarray, "T A B 3"]:
    """Return pictures padded with white to one size."""
    height, width = (max(picture.shape[axis] for picture in pictures) for axis in (0, 1))
    sizes = [((0, height - p.shape[0]), (0, width - p.shape[1]), (0, 0)) for p in pictures]
    return np.stack([np.pad(p, size, constant_values=255) for p, size in zip(pictures, sizes, strict=True)])


def record_scene(dataset: MultiViewDataset, frames: Sequence[int], seconds_per_frame: float = 0.5) -> str:
    """Return a self-contained page with a 3-D recording of frames, which plays in a loop."""
    from nerf_rl.viewer.panels.scene_panel import ScenePanel
    from nerf_rl.viewer.server import serve

    with serve("127.0.0.1", 0, dataset.manifest["scene"]["name"]) as server:
        panel = ScenePanel(server, dataset, read_frame(dataset, frames[0]), lambda: None)
        panel.show(read_frame(dataset, frames[0]))
        recording = server.get_scene_serializer()
        for frame in frames:
            panel.show(read_frame(dataset, frame))
            recording.insert_sleep(seconds_per_frame)
        return recording.as_html()


def _contact_sheet(pictures: Sequence[UInt8[ndarray, "_ _ 3"]]) -> UInt8[ndarray, "A B 3"]:
    return in_columns(list(same_size(pictures)), min(2, len(pictures)), gap=24)


def _write_png(path: Path, picture: UInt8[ndarray, "A B 3"]) -> None:
    with atomic_write(path) as aside:
        aside.write_bytes(cv2.imencode(".png", picture[..., ::-1])[1].tobytes())


def _write_page(
    path: Path,
    title: str,
    slides: Sequence[Slide],
    legend: tuple[Sequence[str], ndarray] | None,
    charts: Sequence[ndarray],
    scene: Callable[[], str] | None,
) -> None:
    page = Page(title)
    if legend is not None:
        page.legend(*legend)
    page.slides([slide.picture for slide in slides], [slide.caption for slide in slides])
    if scene is not None:
        page.heading("In three dimensions")
        page.frame(scene(), 620)
    if charts:
        page.heading("Charts")
    for chart in charts:
        page.image(chart, "")
    write_text(path, page.render())
