"""The whole chain through the real commands, tiny: dataset, encoder, probe, policy, evaluation, page."""

import base64
import json
import re
from pathlib import Path

import cv2
import numpy as np
import pytest
from tiny_recipes import TINY_TRAINING

from nerf_rl import cli


@pytest.fixture(scope="module")
def agent(tiny_encoder: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A policy on the tiny encoder."""
    out = tmp_path_factory.mktemp("chain") / "agent"
    assert cli.main(["train-rl", "--encoder", str(tiny_encoder), "--out", str(out), *TINY_TRAINING]) == 0
    return out


@pytest.fixture(scope="module")
def page(tiny_dataset: Path, tiny_encoder: Path, agent: Path, tmp_path_factory: pytest.TempPathFactory) -> str:
    """The report on all of it."""
    out = tmp_path_factory.mktemp("chain") / "report.html"
    folders = ["--data", str(tiny_dataset), "--encoder", str(tiny_encoder), "--agent", str(agent)]
    assert cli.main(["report", *folders, "--out", str(out), "--episodes", "1"]) == 0
    return out.read_text()


def test_the_page_holds_everything_itself(page: str) -> None:
    sources = re.findall(r'src="([^"]{1,40})', page)
    assert len(sources) == 5 and all(source.startswith("data:") for source in sources)
    assert "http" not in re.sub(r'src="[^"]*"', "", page)


def test_the_page_shows_sheets_reconstructions_and_a_curve(page: str) -> None:
    pictures = re.findall(r'src="data:image/png;base64,([^"]+)"', page)
    for picture in pictures:
        image = cv2.imdecode(np.frombuffer(base64.b64decode(picture), np.uint8), cv2.IMREAD_COLOR)
        assert image.std() > 10  # not blank
    assert len(pictures) == 4


def test_the_clip_on_the_page_plays_and_shows_scene_camera_and_decoded_views(page: str, tmp_path: Path) -> None:
    (content,) = re.findall(r'src="data:video/mp4;base64,([^"]+)"', page)
    path = tmp_path / "clip.mp4"
    path.write_bytes(base64.b64decode(content))
    clip = cv2.VideoCapture(str(path))
    assert int(clip.get(cv2.CAP_PROP_FRAME_COUNT)) == 11  # 20 environment steps at action repeat 2, and the reset
    read, frame = clip.read()
    assert read and frame.shape == (256, 512, 3)
    assert all(frame[:, left : left + 128].std() > 5 for left in (0, 128, 256, 384))


def test_the_page_names_the_figures_of_the_summaries(page: str, tiny_encoder: Path, agent: Path) -> None:
    validation = json.loads((tiny_encoder / "summary.json").read_text())["validation"]
    assert f"PSNR {validation['psnr_db']:.1f} dB, SSIM {validation['ssim']:.2f}, mIoU {validation['miou']:.2f}" in page
    last = json.loads((agent / "summary.json").read_text())["evaluations"][-1]
    assert f"success {last['success_rate']:.0%}" in page
    assert "revision" in page and "torch==" in page


@pytest.mark.parametrize("missing", ["data", "encoder", "agent"])
def test_a_missing_part_is_named_and_nothing_is_written(
    missing: str,
    tiny_dataset: Path,
    tiny_encoder: Path,
    agent: Path,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    folders = {"data": tiny_dataset, "encoder": tiny_encoder, "agent": agent} | {missing: tmp_path / "nothing"}
    arguments = [word for name, folder in folders.items() for word in (f"--{name}", str(folder))]
    assert cli.main(["report", *arguments, "--out", str(tmp_path / "page.html")]) == 2
    assert str(tmp_path / "nothing") in capsys.readouterr().err
    assert not list(tmp_path.iterdir())


def test_a_page_is_not_overwritten_unasked(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    page = tmp_path / "page.html"
    page.write_text("mine")
    assert cli.main(["report", "--data", "a", "--encoder", "b", "--agent", "c", "--out", str(page)]) == 2
    assert "--overwrite true" in capsys.readouterr().err and page.read_text() == "mine"


def test_every_file_of_every_command_has_the_permissions_that_the_umask_gives(
    tiny_dataset: Path, tiny_encoder: Path, agent: Path, tmp_path: Path
) -> None:
    (tmp_path / "new").touch()
    usual = (tmp_path / "new").stat().st_mode
    written = [path for folder in (tiny_dataset, tiny_encoder, agent) for path in folder.rglob("*") if path.is_file()]
    assert len(written) > 25
    assert [path for path in written if path.stat().st_mode != usual] == []
