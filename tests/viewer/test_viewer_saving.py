"""Pages, contact sheets and videos that the viewer writes without a server."""

import re
from pathlib import Path

import cv2
import numpy as np
import pytest

from nerf_rl import cli


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
