"""An estimate tells what a dataset costs and writes nothing; the disk and the graphics card are told of."""

import re
from pathlib import Path

import pytest

from nerf_rl import cli
from nerf_rl.datasets.storage.disk import readable
from nerf_rl.datasets.storage.shards import SHARDS
from nerf_rl.machine import gl


def test_an_estimate_tells_frames_bytes_and_minutes_and_writes_nothing(
    tiny_dataset: Path, tiny_recipe: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
):
    out = tmp_path / "data"
    assert cli.main(["gen-dataset", "--config", str(tiny_recipe), "--out", str(out), "--estimate", "true"]) == 0
    shown = capsys.readouterr().out
    assert list(tmp_path.iterdir()) == []
    assert "12 frames x 4 views of 24 x 24 in 2 shards" in shown
    assert re.search(r"about \d+\.\d minutes with 1 workers: [1-9]\d*\.\d frames/s each", shown)
    told = float(re.search(r"([\d.]+) kB to write; [\d.]+ [GT]B free", shown)[1]) * 1000
    written = sum(path.stat().st_size for path in (tiny_dataset / SHARDS).iterdir())
    assert written == pytest.approx(told, rel=0.15)


@pytest.mark.parametrize(
    "size, words", [(0, "0 bytes"), (999, "999 bytes"), (1500, "1.5 kB"), (250_000_000, "250 MB"), (10**16, "10000 TB")]
)
def test_sizes_are_told_in_units_that_fit(size: int, words: str):
    assert readable(size) == words


def test_software_rendering_beside_a_graphics_card_is_a_warning(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
):
    monkeypatch.setattr(gl, "graphics_card", lambda: "/dev/nvidia0")
    gl.warn_of_software_rendering("NVIDIA H200/PCIe/SSE2")
    assert capsys.readouterr().err == ""
    for renderer in ("llvmpipe (LLVM 15.0.6, 256 bits)", "softpipe", "Software Rasterizer"):
        gl.warn_of_software_rendering(renderer)
        assert (
            f"warning: {renderer} renders on the processor although there is a graphics card" in capsys.readouterr().err
        )
    monkeypatch.setattr(gl, "graphics_card", lambda: None)
    gl.warn_of_software_rendering("llvmpipe (LLVM 15.0.6, 256 bits)")
    assert capsys.readouterr().err == ""
