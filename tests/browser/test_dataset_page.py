"""The dataset's page in a real browser."""

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from looking import Look, Viewer

from nerf_rl.datasets.storage.reader import MultiViewDataset


@pytest.fixture(scope="module")
def viewer(tiny_dataset: Path) -> Iterator[Viewer]:
    running = Viewer(str(tiny_dataset))
    yield running
    running.close()


def test_the_page_shows_a_scene_and_every_camera(viewer: Viewer, look: Look) -> None:
    look.open(viewer.url)
    look.until(lambda: len(look.images()) >= 5, "the cameras' pictures are missing")
    text = look.page.inner_text("body")
    assert all(name in text for name in ("left", "right", "top", "random_0", "drawercase"))


def test_the_slider_changes_the_pictures(viewer: Viewer, look: Look) -> None:
    look.open(viewer.url)
    look.until(lambda: len(look.images()) >= 5, "the cameras' pictures are missing")
    before = look.images()
    look.set_number("Episode", 2)
    look.until(lambda: "episode 2" in look.status(), "the status does not follow the slider")
    look.until(lambda: len(set(look.images()) - set(before)) >= 3, "the pictures do not follow the slider")


def test_a_click_on_a_frustum_looks_through_it(viewer: Viewer, look: Look) -> None:
    look.open(viewer.url)
    before = look.canvas()
    moved = False
    for x, y in look.frusta():
        look.page.mouse.click(x, y)
        look.page.wait_for_timeout(2000)
        moved = np.abs(look.canvas() - before).mean() > 15
        if moved:
            break
    assert moved, "no click on a frustum moved the camera"
    look.keep("through")


def test_the_cloud_takes_the_colours_of_classes_and_a_class_can_be_hidden(
    viewer: Viewer, tiny_dataset: Path, look: Look
) -> None:
    dataset = MultiViewDataset(tiny_dataset)
    colour = dataset.palette[dataset.class_names.index("drawercase")][::-1].astype(float)  # blue, green, red

    def drawn() -> int:
        """Count pixels of the class's colour."""
        return int((np.abs(look.canvas() - colour).max(-1) < 25).sum())

    look.open(viewer.url)
    assert drawn() < 10
    look.page.locator("xpath=//label[normalize-space(text())='Point cloud']/following::input[1]").first.click()
    look.page.get_by_role("option", name="semantic").click()
    look.until(lambda: drawn() > 100, "the cloud keeps its colours")
    look.page.get_by_text("Classes in the point cloud").click()
    look.page.locator("xpath=//label[normalize-space(text())='drawercase']/following::input[1]").first.click()
    look.until(lambda: drawn() < 10, "the class stays")


def test_play_goes_on_by_itself(viewer: Viewer, look: Look) -> None:
    look.open(viewer.url)
    before = look.status()
    look.page.get_by_role("button", name="Play").click()
    look.until(lambda: look.status() != before, "nothing plays")
    look.page.get_by_role("button", name="Pause").click()


def test_two_viewers_serve_at_once_and_a_closed_tab_ends_neither(
    viewer: Viewer, tiny_dataset: Path, look: Look
) -> None:
    other = Viewer(str(tiny_dataset))
    try:
        assert other.url != viewer.url
        for running in (other, viewer, other):
            look.open(running.url)
        assert other.process.poll() is None
    finally:
        look.page.goto("about:blank")
        code = other.interrupt()
        other.close()
    assert code == 0
    assert viewer.process.poll() is None
