"""Pretraining to its end on other scenes than the demo's."""

import json
from pathlib import Path

import pytest

from nerf_rl import cli
from nerf_rl.pretrain.model.encoder import Encoder

ROOT = Path(__file__).parents[2]

HIDDEN = """
<mujoco>
  <worldbody>
    <light pos="0 0 3" dir="0 0 -1"/>
    <geom type="plane" size="2 2 0.1" rgba="0.4 0.5 0.6 1"/>
    <body name="near" pos="0 0 0.1"><joint type="slide" axis="1 0 0" range="-0.1 0.1" limited="true"/>
      <geom type="box" size="0.05 0.05 0.05" rgba="0.9 0.2 0.1 1"/></body>
    <body name="buried" pos="0 0 -0.5"><joint type="slide" axis="1 0 0" range="-0.1 0.1" limited="true"/>
      <geom type="box" size="0.05 0.05 0.05" rgba="0.1 0.9 0.2 1"/></body>
  </worldbody>
</mujoco>
"""


def generate(out: Path, *words: str) -> Path:
    size = ["--episodes", "4", "--frames_per_episode", "3", "--size", "32", "--workers", "1"]
    assert cli.main(["gen-dataset", *words, *size, "--out", str(out)]) == 0
    return out


def test_a_class_that_no_frame_shows_has_no_iou_and_the_run_ends(
    tmp_path: Path, tiny_pretraining_recipe: Path, capsys: pytest.CaptureFixture[str]
):
    (tmp_path / "scene.xml").write_text(HIDDEN)
    data = generate(tmp_path / "data", "--scene", str(tmp_path / "scene.xml"), "--episode_steps", "10")
    out = tmp_path / "run"
    words = ["--config", str(tiny_pretraining_recipe), "--data", str(data), "--out", str(out)]
    assert cli.main(["pretrain", *words]) == 0
    summary = json.loads((out / "summary.json").read_text())
    assert not summary["class_iou"]["buried"]  # 0 where the young field takes some pixels for it, else unknown
    shown = [value for value in summary["class_iou"].values() if value is not None]
    assert summary["validation"]["miou"] == pytest.approx(sum(shown) / len(shown))
    assert Encoder.load(out).scene == str(tmp_path / "scene.xml")
    told = capsys.readouterr().out
    assert "mIoU" in told and "; hardly any picture shows buried, so z is not told where that is\n" in told


def test_the_shipped_blocks_pretrain_to_the_end(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.chdir(ROOT)  # the recipe names its scene from there
    data = generate(tmp_path / "data", "--config", "datasets/blocks.yaml")
    out = tmp_path / "run"
    words = ["--config", "pretrain/demo.yaml", "--data", str(data), "--out", str(out)]
    few = ["--steps", "3", "--validation_frames", "2", "--probe_frames", "9"]
    assert cli.main(["pretrain", *words, *few]) == 0
    summary = json.loads((out / "summary.json").read_text())
    assert summary["steps"] == 3 and "block" in summary["class_iou"]
    assert len(Encoder.load(out).rig.names) == 3
