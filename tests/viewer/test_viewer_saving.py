"""Pages, contact sheets and videos that the viewer writes without a server."""

import re
from functools import partial
from pathlib import Path

import cv2
import numpy as np
import pytest

from nerf_rl import cli
from nerf_rl.errors import UserError
from nerf_rl.viewer.drawing.slides import Slide
from nerf_rl.viewer.pages.saving import save


def test_a_dataset_becomes_a_page_that_holds_everything_itself(tiny_dataset: Path, tmp_path: Path) -> None:
    files = {name: tmp_path / f"x.{suffix}" for name, suffix in (("save", "html"), ("png", "png"), ("mp4", "mp4"))}
    keys = [word for name, path in files.items() for word in (f"--{name}", str(path))]
    assert cli.main(["view", str(tiny_dataset), "--frames", "3", *keys]) == 0
    page = files["save"].read_text()
    assert page.count("data:image/jpeg;base64,") == 3 and "__VISER_EMBED_DATA__" in page
    outside = re.sub(r'srcdoc="[^"]*"', "", page)
    assert not re.search(r'(src|href)="(?!data:)', outside) and "drawercase" in outside
    assert cv2.imread(str(files["png"])).std() > 20
    clip = cv2.VideoCapture(str(files["mp4"]))
    assert int(clip.get(cv2.CAP_PROP_FRAME_COUNT)) == 3


@pytest.mark.parametrize("kind", ["encoder", "agent"])
def test_encoders_and_agents_become_contact_sheets(
    kind: str, tiny_encoder: Path, tiny_agent: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "deep" / "x.png"
    folder = {"encoder": tiny_encoder, "agent": tiny_agent}[kind]
    assert cli.main(["view", str(folder), "--png", str(path), "--frames", "2", "--episodes", "1"]) == 0
    assert f"wrote {path}" in capsys.readouterr().out
    picture = cv2.imread(str(path))
    assert picture.std() > 20 and np.unique(picture.reshape(-1, 3), axis=0).shape[0] > 50


def test_a_contact_sheet_alone_draws_six_slides_of_many_and_is_the_one_beside_a_video(tmp_path: Path) -> None:
    drawn: list[int] = []

    def draw(place: int) -> Slide:
        drawn.append(place)
        return Slide(np.full((16, 16, 3), 10 * place, np.uint8), f"slide {place}")

    slides = [partial(draw, place) for place in range(20)]
    save({"png": tmp_path / "alone.png"}, "title", slides, None, list)
    assert drawn == [0, 3, 7, 11, 15, 19]
    drawn.clear()
    save({"png": tmp_path / "beside.png", "mp4": tmp_path / "video.mp4"}, "title", slides, None, list)
    assert drawn == list(range(20))
    sheet = cv2.imread(str(tmp_path / "alone.png"))
    assert set(np.unique(sheet)) == {0, 30, 70, 110, 150, 190, 255}
    np.testing.assert_array_equal(sheet, cv2.imread(str(tmp_path / "beside.png")))


def test_a_folder_that_cannot_be_made_is_told_before_anything_is_drawn() -> None:
    def never() -> Slide:
        raise AssertionError("drawn in vain")

    with pytest.raises(UserError, match=r"/proc/nowhere/x/a\.png cannot be written"):
        save({"png": Path("/proc/nowhere/x/a.png")}, "title", [never], None, list)
