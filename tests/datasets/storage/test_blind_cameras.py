"""A camera before which something stands, or that looks elsewhere, is told: what it misses, the others see."""

from pathlib import Path

import pytest

from nerf_rl import cli
from nerf_rl.datasets.storage.blind_cameras import warn_of_blind_cameras
from nerf_rl.datasets.storage.reader import MultiViewDataset
from nerf_rl.files.json_files import read_json

SCENE = """<mujoco><worldbody><light pos="0 0 3"/><geom type="plane" size="3 3 0.1"/>
<geom type="box" pos="0.6 0 0.5" size="0.05 1 0.5" rgba="0.8 0.6 0.3 1"/>
<body name="cart" pos="0 0 0.2"><joint name="rail" type="slide" axis="0 1 0" limited="true" range="-0.3 0.3"/>
<geom type="box" size="0.1 0.1 0.1" rgba="0.9 0.1 0.1 1"/></body></worldbody>
<actuator><motor joint="rail" gear="3" ctrlrange="-1 1" ctrllimited="true"/></actuator></mujoco>"""
RECIPE = """
episodes: 2
episodes_per_shard: 1
frames_per_episode: 3
episode_steps: 6
size: 32
workers: 1
rig:
  cameras:
    - {name: open, position: [-1.5, 0, 0.8], lookat: [0, 0, 0.2]}
    - {name: walled, position: [1.5, 0, 0.4], lookat: [0, 0, 0.2]}
    - {name: astray, position: [-1.5, 0, 0.8], lookat: [-3, 0, 0]}
  test: [astray]
"""
BLIND = {"walled": 1.0, "astray": 1.0}


@pytest.fixture
def words(tmp_path: Path) -> list[str]:
    """Arguments that render a cart, with a wall before one camera and another one turned away."""
    (tmp_path / "scene.xml").write_text(SCENE)
    (tmp_path / "recipe.yaml").write_text(RECIPE)
    return ["gen-dataset", "--config", str(tmp_path / "recipe.yaml"), "--scene", str(tmp_path / "scene.xml")]


def test_cameras_that_miss_what_others_see_are_warned_of(
    words: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
):
    assert cli.main([*words, "--out", str(tmp_path / "data")]) == 0
    warnings = [line for line in capsys.readouterr().err.splitlines() if line.startswith("warning: camera")]
    assert [line.split()[2] for line in warnings] == [*BLIND]
    assert all("in 100% of the frames" in line and str(tmp_path / "data") in line for line in warnings)
    assert read_json(tmp_path / "data" / "summary.json")["blind_cameras"] == BLIND


def test_parts_tell_of_them_when_they_are_put_together(
    words: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
):
    for part in ("1/2", "2/2"):
        assert cli.main([*words, "--out", str(tmp_path / "data"), "--shard", part]) == 0
    assert "warning: camera" not in capsys.readouterr().err
    assert cli.main(["merge", str(tmp_path / "data")]) == 0
    assert capsys.readouterr().err.count("warning: camera") == len(BLIND)
    assert read_json(tmp_path / "data" / "summary.json")["blind_cameras"] == BLIND


def test_imported_pictures_are_looked_at_too(words: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    assert cli.main([*words, "--out", str(tmp_path / "data")]) == 0
    assert cli.main(["export", str(tmp_path / "data"), "--out", str(tmp_path / "scenes")]) == 0
    capsys.readouterr()
    nothing = ["--empty_depth", "nothing", "--out", str(tmp_path / "back")]
    assert cli.main(["import", str(tmp_path / "scenes"), *nothing]) == 0
    assert capsys.readouterr().err.count("warning: camera") == len(BLIND)
    assert read_json(tmp_path / "back" / "summary.json")["blind_cameras"] == BLIND


def test_where_all_cameras_see_something_or_none_does_there_is_nothing_to_tell(
    words: list[str], tiny_dataset: Path, tmp_path: Path
):
    assert warn_of_blind_cameras(tiny_dataset) == {}
    astray = "[{name: astray, position: [-1.5, 0, 0.8], lookat: [-3, 0, 0]}]"
    assert cli.main([*words, "--out", str(tmp_path / "data"), "--rig.cameras", astray, "--rig.test", "[]"]) == 0
    assert "blind_cameras" not in warn_of_blind_cameras(tmp_path / "data")


def test_a_dataset_in_which_no_camera_sees_what_moves_is_warned_of(
    words: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
):
    astray = "[{name: astray, position: [-1.5, 0, 0.8], lookat: [-3, 0, 0]}]"
    assert cli.main([*words, "--out", str(tmp_path / "data"), "--rig.cameras", astray, "--rig.test", "[]"]) == 0
    said = [line for line in capsys.readouterr().err.splitlines() if line.startswith("warning: ")]
    assert len(said) == 1 and "no camera sees anything but the background in any of 6 frames" in said[0]
    assert str(tmp_path / "data") in said[0]


def test_around_a_large_ground_what_moves_is_seen_all_the_same(words: list[str], tmp_path: Path):
    """MuJoCo's near plane, a hundredth of the model's size, is farther away than the cart."""
    scene = tmp_path / "scene.xml"
    scene.write_text(SCENE.replace('type="plane" size="3 3 0.1"', 'type="box" size="90 90 0.1" pos="0 0 -0.1"'))
    assert cli.main([*words, "--out", str(tmp_path / "data")]) == 0
    dataset = MultiViewDataset(tmp_path / "data")
    assert read_json(tmp_path / "data" / "summary.json")["blind_cameras"] == BLIND
    cart = dataset.read("semantic")[:, dataset.camera_names.index("open")] == dataset.class_names.index("robot")
    assert (cart.mean((1, 2)) > 0.005).all()
