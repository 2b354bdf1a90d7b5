"""The encoder's and the agent's page in a real browser, and a saved page."""

from pathlib import Path

import numpy as np
from looking import Look, Viewer

from nerf_rl import cli


def test_the_field_is_rendered_and_follows_the_mouse(tiny_encoder: Path, tiny_dataset: Path, look: Look) -> None:
    running = Viewer(str(tiny_encoder), "--data", str(tiny_dataset))
    try:
        look.open(running.url)
        look.until(lambda: " ms" in look.page.inner_text("body"), "the field is not rendered")
        before = look.canvas()
        look.page.mouse.move(760, 450)
        look.page.mouse.down()
        look.page.mouse.move(900, 400, steps=8)
        look.page.mouse.up()
        look.until(lambda: np.abs(look.canvas() - before).mean() > 4, "the camera does not move")
        look.page.get_by_text("From z", exact=True).click()
        look.until(lambda: len(look.images()) >= 4, "nothing is decoded")
        look.keep("decoded")
        look.page.get_by_text("Probe", exact=True).click()
        look.until(lambda: "hand_x" in look.page.inner_text("body"), "the probe is missing")
        assert running.interrupt() == 0
    finally:
        running.close()


def test_the_agents_page_shows_an_episode_and_its_learning(tiny_agent: Path, look: Look) -> None:
    running = Viewer(str(tiny_agent), "--episodes", "2")
    try:
        look.open(running.url)
        look.until(lambda: "reward" in look.page.inner_text("body"), "no episode is shown")
        look.until(lambda: len(look.images()) >= 3, "the episode's pictures are missing")
        before = look.images()
        look.set_number("Step", 4)
        look.until(lambda: "step 4 of" in look.status(), "the status does not follow the slider")
        look.until(lambda: look.images() != before, "the pictures do not follow the slider")
        look.keep("step")
        look.page.get_by_text("Learning", exact=True).click()
        look.until(lambda: len(look.images()) >= 1, "the learning curves are missing")
    finally:
        running.close()


def test_a_saved_page_opens_from_its_file_alone(tiny_dataset: Path, tmp_path: Path, look: Look) -> None:
    assert cli.main(["view", str(tiny_dataset), "--frames", "3", "--save", str(tmp_path / "x.html")]) == 0
    look.page.goto((tmp_path / "x.html").as_uri())
    first = look.page.get_attribute(".slides img", "src")
    look.page.locator(".slides input").fill("2")
    assert look.page.get_attribute(".slides img", "src") != first
    inside = look.page.frame_locator("iframe").locator("canvas[data-engine]")
    inside.wait_for(timeout=60_000)
    inside.scroll_into_view_if_needed()

    def drawn() -> bool:
        return look.picture("iframe").std() > 10

    look.until(drawn, "the recording stays blank")
