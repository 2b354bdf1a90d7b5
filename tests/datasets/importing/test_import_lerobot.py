"""LeRobotDatasets as datasets: what was exported comes back; without camera poses there is none."""

import json
import re
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from tiny_recipes import generate_whole_episodes

from nerf_rl import cli
from nerf_rl.datasets.storage.frames import position_columns
from nerf_rl.datasets.storage.reader import MultiViewDataset

pytest.importorskip("av", reason="the extra 'lerobot' (PyAV) is not installed")
parquet = pytest.importorskip("pyarrow.parquet", reason="the extra 'lerobot' (PyArrow) is not installed")

EPISODES, STEPS = 4, 5
PRETRAIN = Path(__file__).parents[3] / "pretrain"
TINY = ["--steps", "2", "--steps_per_epoch", "2", "--epochs_per_validation", "1", "--validation_frames", "1"]
TINY += ["--scenes_per_step", "2", "--rays_per_scene", "8", "--threads", "1", "--probe_frames", "9"]
TINY += ["--sampling.rendering_stratified", "6", "--sampling.rendering_importance", "4"]


@pytest.fixture(scope="module")
def original(tiny_recipe: Path, tmp_path_factory: pytest.TempPathFactory) -> MultiViewDataset:
    """All steps of four episodes, seen by three fixed cameras and one that moves between frames."""
    return generate_whole_episodes(tiny_recipe, tmp_path_factory.mktemp("whole") / "dataset", EPISODES, STEPS)


@pytest.fixture(scope="module")
def export(original: MultiViewDataset, tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("export") / "out"
    assert cli.main(["export", str(original.folder), "--format", "lerobot", "--out", str(out)]) == 0
    return out


@pytest.fixture(scope="module")
def imported(export: Path, tmp_path_factory: pytest.TempPathFactory) -> MultiViewDataset:
    out = tmp_path_factory.mktemp("imported") / "out"
    assert cli.main(["import", str(export), "--out", str(out), "--episodes_per_shard", "3"]) == 0
    return MultiViewDataset(out)


def test_an_export_comes_back_up_to_its_videos(original: MultiViewDataset, export: Path, imported: MultiViewDataset):
    frames = np.flatnonzero(original.read("step") < STEPS)  # the last state of an episode is not exported
    views = [original.camera_names.index(name) for name in imported.camera_names]
    assert imported.absent == () and len(imported) == len(frames)
    np.testing.assert_array_equal(imported.read("semantic"), original.read("semantic", frames)[:, views])
    difference = np.abs(imported.read("rgb").astype(int) - original.read("rgb", frames)[:, views])
    assert difference.mean() < 10  # colours are lossy, at half the resolution
    depth, truth = imported.read("depth"), original.read("depth", frames)[:, views]
    hit = truth < 0.999 * original.manifest["far"]
    features = json.loads((export / "meta" / "info.json").read_text())["features"]
    for view, name in enumerate(imported.camera_names):
        info = features[f"observation.images.{name}_depth"]["info"]
        half_a_code = np.exp(np.log(info["video.depth_max"] / info["video.depth_min"]) / 4095 / 2) - 1
        here = hit[:, view]
        np.testing.assert_allclose(depth[:, view][here], truth[:, view][here], rtol=1.01 * half_a_code)
    np.testing.assert_array_equal(depth[~hit], imported.manifest["far"])
    for name in ("state/proprio", "state/privileged", "state/action", "step", "episode", "split"):
        np.testing.assert_array_equal(imported.read(name), original.read(name, frames))
    np.testing.assert_array_equal(imported.read("reward"), original.read("reward", frames))
    np.testing.assert_array_equal(imported.read("success"), original.read("success", frames))
    for group in ("proprio", "privileged", "action"):
        assert imported.columns(group) == original.columns(group)
    for mine, theirs in zip(imported.cameras(np.arange(len(imported))), original.cameras(frames), strict=True):
        np.testing.assert_allclose(mine, theirs[views] if mine.ndim == 3 else theirs[:, views], atol=1e-6)
    roles = {camera["name"]: camera["role"] for camera in original.manifest["cameras"]}
    assert {camera["name"]: camera["role"] for camera in imported.manifest["cameras"]} == roles


def test_pretrain_and_probe_take_it(imported: MultiViewDataset, tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    assert cli.main(["check", str(imported.folder)]) == 0
    recipe = ["--config", str(PRETRAIN / "demo.yaml"), *TINY]
    assert cli.main(["pretrain", *recipe, "--data", str(imported.folder), "--out", str(tmp_path / "run")]) == 0
    probe = ["--encoder", str(tmp_path / "run"), "--data", str(imported.folder), "--frames", "9"]
    assert cli.main(["probe", *probe]) == 0
    assert "hand_x" in capsys.readouterr().out
    assert cli.main(["view", str(imported.folder), "--png", str(tmp_path / "a.png"), "--frames", "2"]) == 0


def test_it_goes_back_out_with_the_rate_said(imported: MultiViewDataset, tmp_path: Path):
    command = ["export", str(imported.folder), "--format", "lerobot", "--out", str(tmp_path / "out")]
    assert cli.main(command) == 2  # nothing simulates it, so nothing knows its rate
    assert cli.main([*command, "--fps", "80"]) == 0


def test_depth_and_labels_that_it_lacks_stay_away(imported: MultiViewDataset, export: Path, tmp_path: Path):
    words = ["--format", "lerobot", "--fps", "80", "--depth", "false"]
    assert cli.main(["export", str(imported.folder), *words, "--out", str(tmp_path / "colours")]) == 0
    shutil.rmtree(tmp_path / "colours" / "labels")
    assert cli.main(["import", str(tmp_path / "colours"), "--out", str(tmp_path / "data")]) == 0
    dataset = MultiViewDataset(tmp_path / "data")
    assert dataset.absent == ("depth", "labels")
    assert cli.main(["export", str(dataset.folder), *words[:4], "--out", str(tmp_path / "again")]) == 0
    features = json.loads((tmp_path / "again" / "meta" / "info.json").read_text())["features"]
    assert not any(key.endswith("_depth") for key in features) and not (tmp_path / "again" / "labels").exists()
    cameras = json.loads((tmp_path / "again" / "meta" / "cameras.json").read_text())
    assert not {"classes", "labels_path"} & set(cameras) and cameras["cameras"][0]["depth_key"] is None
    assert cli.main(["import", str(tmp_path / "again"), "--out", str(tmp_path / "back")]) == 0
    back = MultiViewDataset(tmp_path / "back")
    kept = np.flatnonzero(dataset.read("step") < STEPS - 2)  # each export leaves out the last state of an episode
    assert back.absent == dataset.absent
    np.testing.assert_array_equal(back.read("state/privileged"), dataset.read("state/privileged", kept))
    assert cli.main(["view", str(dataset.folder), "--save", str(tmp_path / "a.html"), "--frames", "1"]) == 0
    page = re.sub(r'srcdoc="[^"]*"', "", (tmp_path / "a.html").read_text())  # without the 3-D recording
    assert "Charts" in page and "background<" not in page  # charts of the state, which is known


def edit(file: str, change: Callable[[dict], Any]) -> Callable[[Path], None]:
    def apply(folder: Path) -> None:
        content = json.loads((folder / file).read_text())
        change(content)
        (folder / file).write_text(json.dumps(content))

    return apply


def camera(**keys: Any) -> Callable[[Path], None]:
    return edit("meta/cameras.json", lambda content: content["cameras"][1].update(keys))


def remove(file: str) -> Callable[[Path], None]:
    return lambda folder: (folder / file).unlink()


def text(file: str) -> Callable[[Path], None]:
    """Return what makes a list of other files out of a video, which FFmpeg follows if it is let."""
    return lambda folder: (folder / file).write_text("ffconcat version 1.0\nfile /etc/passwd\n") and None


def link(file: str) -> Callable[[Path], None]:
    def apply(folder: Path) -> None:
        (folder / file).rename(folder.parent / "elsewhere")
        (folder / file).symlink_to(folder.parent / "elsewhere")

    return apply


def rewrite(file: str, change: Callable[[Any], Any]) -> Callable[[Path], None]:
    return lambda folder: parquet.write_table(change(parquet.read_table(folder / file)), folder / file)


_EPISODES, _DATA = "meta/episodes/chunk-000/file-000.parquet", "data/chunk-000/file-000.parquet"
_VIDEO = "videos/observation.image/chunk-000/file-000.mp4"
FAULTS = [
    (remove("meta/cameras.json"), "it has no meta/cameras.json, so nothing says where its cameras are"),
    (camera(world_from_camera=None), "it needs one of world_from_camera and world_from_camera_key"),
    (camera(world_from_camera=np.diag([2.0, 1, 1, 1]).tolist()), "is not rigid"),
    (camera(image_key="../../x"), "cameras.1.image_key is '../../x' instead of a name of letters"),
    (camera(image_key="observation.images.other"), "a feature observation.images.other that meta/info.json does not"),
    (camera(height=10**9), "height is 1000000000 instead of a whole number"),
    (camera(width=26), "its cameras have pictures of different sizes"),
    (camera(name="left"), "two cameras have one name"),
    (camera(depth_key=None), "some of its cameras have depth and some have none"),
    (edit("meta/cameras.json", lambda c: c["classes"].__delitem__(slice(2, None))), "and meta/cameras.json names"),
    (edit("meta/info.json", lambda c: c.update(codebase_version="v2.1")), "its version is v2.1, and v3.x is read"),
    (edit("meta/info.json", lambda c: c.update(video_path="/tmp/{video_key}")), "not LeRobot's own"),
    (edit("meta/info.json", lambda c: c.update(total_frames=10**9)), "total_frames is 1000000000"),
    (edit("meta/info.json", lambda c: c.update(total_frames=7)), "than the dataset has|7 frames together"),
    (edit("meta/info.json", lambda c: c["features"]["action"].update(shape=[10**9])), "action has 1000000000 numbers"),
    (edit("meta/info.json", lambda c: c["features"]["action"].update(shape=[3])), "action has the shape (4,)"),
    (remove(_EPISODES), "is not there"),
    (remove(_DATA), "is not there"),
    (remove(_VIDEO), "is not there"),
    (text(_VIDEO), "it cannot be decoded"),
    (text(_DATA), "Parquet"),
    (link(_VIDEO), "a link that leads out of its folder"),
    (link(_DATA), "a link that leads out of its folder"),
    (rewrite(_DATA, lambda table: table.slice(0, 7)), "episode 1 does not have frames 0 to 4 in order"),
    (rewrite(_DATA, lambda table: table.drop_columns(["action"])), "it has no column action"),
    (rewrite(_EPISODES, lambda table: table.slice(0, 2)), "its episodes are not those numbered 0 to 3"),
]


@pytest.mark.parametrize("damage, fault", FAULTS)
def test_a_fault_is_one_sentence(
    export: Path, tmp_path: Path, capfd: pytest.CaptureFixture[str], damage: Callable[[Path], None], fault: str
):
    source = Path(shutil.copytree(export, tmp_path / "source"))
    damage(source)
    assert cli.main(["import", str(source), "--out", str(tmp_path / "out")]) in (1, 2)
    said = [line for line in capfd.readouterr().err.splitlines() if line.startswith("nerf-rl")]
    assert len(said) == 1 and str(source) in said[0]
    assert any(part in said[0] for part in fault.split("|")), said
    assert not (tmp_path / "out" / "manifest.json").exists()


def test_positions_of_the_true_state_are_in_metres_too():
    names = ("hand_x", "hand_y", "hand_z", "opening", "tilt_x", "cup_z", "cup_x", "cup_y")
    assert position_columns(names) == [0, 1, 2, 5, 6, 7]
