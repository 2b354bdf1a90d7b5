"""Images that are larger than OpenGL's: views take turns, and one that is too large by itself is told."""

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from test_renderer import loaded, random_cameras

from nerf_rl import cli
from nerf_rl.errors import UserError
from nerf_rl.machine.gl import largest_image
from nerf_rl.rendering import offscreen_target
from nerf_rl.rendering.renderer import MultiViewRenderer


@pytest.fixture
def limit() -> Iterator[tuple[int, int]]:
    """The most rows and columns that OpenGL draws here, which is asked of a context."""
    renderer = MultiViewRenderer(loaded()[0], 8, 8, 1)
    assert renderer.gl_renderer  # makes its context the current one
    yield largest_image()
    renderer.close()


@pytest.mark.parametrize("quality, side, rounding", [("fast", 48, 0), ("smooth", 96, 1), ("full", 48, 0)])
def test_cameras_that_opengl_has_no_room_for_at_once_take_turns(
    quality: str, side: int, rounding: int, monkeypatch: pytest.MonkeyPatch
):
    model, data = loaded()
    intrinsics, poses = random_cameras(np.random.default_rng(13), 7, 48, (0.0, 0.0, 0.1))
    at_once = MultiViewRenderer(model, 48, 48, 7, quality)
    expected = at_once.render(data, intrinsics, poses)
    at_once.close()
    monkeypatch.setattr(offscreen_target, "largest_image", lambda: (3 * side + 47, side))
    in_turns = MultiViewRenderer(model, 48, 48, 7, quality)
    for count in (7, 6, 2):
        views = in_turns.render(data, intrinsics[:count], poses[:count])
        np.testing.assert_allclose(views.rgb.astype(int), expected.rgb[:count], rtol=0, atol=rounding)
        np.testing.assert_array_equal(views.geom, expected.geom[:count])
        np.testing.assert_allclose(views.depth, expected.depth[:count], rtol=1e-5)
        np.testing.assert_array_equal(in_turns.render_rgb(data, intrinsics[:count], poses[:count]), views.rgb)
    in_turns.close()


def test_any_number_of_cameras_is_drawn_whatever_opengls_limit_is(limit: tuple[int, int]):
    model, data = loaded()
    rows, _ = limit
    size, kinds = 24, 5
    count = 2 * (rows // size) + 1
    intrinsics, poses = random_cameras(np.random.default_rng(14), kinds, size, (0.0, 0.0, 0.1))
    kind = np.arange(count) % kinds
    many, few = MultiViewRenderer(model, size, size, count), MultiViewRenderer(model, size, size, kinds)
    expected = few.render_rgb(data, intrinsics, poses)
    seen = many.render_rgb(data, intrinsics[kind], poses[kind])
    assert seen.shape == (count, size, size, 3)
    differing = (seen != expected[kind]).any(-1).mean(axis=(1, 2))
    assert differing.max() < 0.05 and differing.mean() < 0.005  # rounding grows along OpenGL's image
    many.close()
    few.close()


def test_a_view_larger_than_opengl_draws_is_answered_with_the_limit(limit: tuple[int, int]):
    model, _ = loaded()
    rows, columns = limit
    words = f"a view of 8 x {rows + 1} pixels is larger than what OpenGL draws here; .* is {columns} x {rows} pixels"
    with pytest.raises(UserError, match=words):
        MultiViewRenderer(model, rows + 1, 8, 1)
    with pytest.raises(UserError, match=f"a view of {columns + 1} x 8 pixels is larger"):
        MultiViewRenderer(model, 8, columns + 1, 1)
    words = f"a view of 16 x {rows + 2} pixels .*; smooth pictures are drawn 2 times as large"
    with pytest.raises(UserError, match=words):
        MultiViewRenderer(model, rows // 2 + 1, 8, 1, "smooth")


def test_a_dataset_of_views_larger_than_anything_is_refused_in_a_sentence(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
):
    out = tmp_path / "data"
    arguments = ["--scene", "datasets/scenes/blocks.xml", "--episodes", "1", "--size", "100000"]
    assert cli.main(["gen-dataset", "--out", str(out), *arguments]) == 2
    shown = capsys.readouterr().err
    assert "--size must be at most 4096, got 100000" in shown
    assert shown.count("\n") == 1 and not out.exists()
