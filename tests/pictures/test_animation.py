"""The README's moving picture, made from a tiny agent by the tool that makes it from the demo's."""

from pathlib import Path

import cv2
import numpy as np
import pytest
from numpy import ndarray

from tools.pictures import animation


def read(path: Path) -> list[ndarray]:
    """Return a WebP's frames, one for each 0.25 s, since equal ones are stored as one that stays longer."""
    read, film = cv2.imreadanimation(str(path))
    assert read and film.loop_count == 0  # plays in a loop
    return [frame for frame, stay in zip(film.frames, film.durations, strict=True) for _ in range(int(stay) // 250)]


def test_the_moving_picture_shows_each_action_beside_what_z_decodes_to(
    tiny_agent: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
):
    out = tmp_path / "agent.webp"
    words = ["--agent", str(tiny_agent), "--out", str(out), "--seeds", "3", "--every", "1", "--hold", "0.5"]
    monkeypatch.setattr("sys.argv", ["animation.py", *words])
    animation.main()
    assert "seed 3: " in capsys.readouterr().out

    frames = read(out)
    assert len(frames) == 11 + 2  # 20 environment steps at action repeat 2, and the reset; the last one stays 0.5 s
    scene, cell, gap = animation.SCENE, animation.CELL, animation.GAP
    top, views = 18 + gap, 2  # below a line of text; of the tiny encoder
    assert frames[0].shape[1] == scene + 4 * cell + 3 * gap + 4 * gap
    first, last = (frames[i][top : top + scene, :scene].astype(int) for i in (0, -1))
    assert np.abs(first - last).mean() > 0.5  # it moves
    for column in range(4):
        left = scene + 2 * gap + column * (cell + gap)
        for row in range(views):
            below = top + row * (cell + gap)
            assert frames[0][below : below + cell, left : left + cell].std() > 3, f"row {row}, column {column}"
    assert np.array_equal(frames[-1], frames[-3])
