"""Exports as a LeRobotDataset, read back with PyArrow and PyAV, and by LeRobot itself where that is at hand."""

import json
import math
import os
import subprocess
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from tiny_recipes import generate_whole_episodes

from nerf_rl import cli
from nerf_rl.cameras.geometry import project
from nerf_rl.datasets.export.lerobot import part as lerobot_part
from nerf_rl.datasets.export.lerobot.depth_codes import TOPMOST, DepthCodes
from nerf_rl.datasets.export.lerobot.episodes import whole_episodes
from nerf_rl.datasets.export.lerobot.statistics import of_histograms, of_values, together
from nerf_rl.datasets.storage.reader import MultiViewDataset

av = pytest.importorskip("av", reason="the extra 'lerobot' (PyAV) is not installed")
parquet = pytest.importorskip("pyarrow.parquet", reason="the extra 'lerobot' (PyArrow) is not installed")

EPISODES, STEPS, SIZE, RATE = 3, 12, 24, 80
LEROBOT_PYTHON = os.environ.get("LEROBOT_PYTHON")
TOOL = Path(__file__).parents[3] / "tools" / "check_lerobot.py"


@pytest.fixture(scope="module")
def dataset(tiny_recipe: Path, tmp_path_factory: pytest.TempPathFactory) -> MultiViewDataset:
    """All steps of three episodes, seen by three fixed cameras and one that moves between frames."""
    return generate_whole_episodes(tiny_recipe, tmp_path_factory.mktemp("whole") / "dataset", EPISODES, STEPS)


@pytest.fixture(scope="module")
def export(dataset: MultiViewDataset, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return exported(dataset, tmp_path_factory.mktemp("export") / "out")


def exported(dataset: MultiViewDataset, out: Path, *arguments: str) -> Path:
    """Run the command and return its output folder."""
    assert cli.main(["export", str(dataset.folder), "--format", "lerobot", "--out", str(out), *arguments]) == 0
    return out


def read_json(path: Path) -> Any:
    return json.loads(path.read_text())


def table(folder: Path, name: str) -> dict[str, np.ndarray]:
    """Return the columns of all Parquet files in a folder, one after the other."""
    tables = [parquet.read_table(path) for path in sorted((folder / name).glob("*/*.parquet"))]
    return {key: np.concatenate([np.array(t[key].to_pylist()) for t in tables]) for key in tables[0].column_names}


def largest_error(codes: DepthCodes) -> float:
    """Return how far depth may be off, as a share of it: half of the step from one code to the next."""
    return math.expm1(math.log(codes.farthest / codes.nearest) / TOPMOST / 2)


def pictures(folder: Path, kind: str, key: str, pixels: str) -> np.ndarray:
    """Return all pictures of a camera, of all files, and check that each is where its time says."""
    found = []
    for path in sorted((folder / kind / key).glob("*/*.mp4")):
        with av.open(str(path)) as container:
            frames = list(container.decode(container.streams.video[0]))
        times = [frame.pts * frame.time_base for frame in frames]
        assert times == [Fraction(i, RATE) for i in range(len(frames))]
        found += [frame.to_ndarray(format=pixels) for frame in frames]
    return np.stack(found)


def shown(dataset: MultiViewDataset) -> np.ndarray:
    """Return the frames that have a next one."""
    return np.flatnonzero(dataset.read("step") < STEPS)


def test_a_frame_holds_a_state_and_the_step_from_it(dataset: MultiViewDataset, export: Path):
    frames, data = shown(dataset), table(export, "data")
    for key, name in {"observation.state": "proprio", "privileged_state": "privileged", "action": "action"}.items():
        np.testing.assert_array_equal(data[key].astype(np.float32), dataset.read(f"state/{name}", frames))
    np.testing.assert_array_equal(data["next.reward"].astype(np.float32), dataset.read("reward", frames + 1))
    np.testing.assert_array_equal(data["next.success"], dataset.read("success", frames + 1).astype(bool))
    np.testing.assert_array_equal(data["next.done"], dataset.read("step", frames) == STEPS - 1)
    np.testing.assert_array_equal(data["frame_index"], dataset.read("step", frames))
    np.testing.assert_array_equal(data["episode_index"], dataset.read("episode", frames))
    np.testing.assert_array_equal(data["index"], np.arange(EPISODES * STEPS))
    np.testing.assert_allclose(data["timestamp"], data["frame_index"] / RATE, rtol=1e-6)


def test_labels_are_exact_depth_is_within_its_codes_and_colours_are_close(dataset: MultiViewDataset, export: Path):
    frames, features = shown(dataset), read_json(export / "meta/info.json")["features"]
    far = 0.999 * dataset.manifest["far"]
    background = 0
    for camera in read_json(export / "meta/cameras.json")["cameras"]:
        view = dataset.camera_names.index(camera["name"])
        labels = pictures(export, "labels", camera["image_key"], "gray")
        np.testing.assert_array_equal(labels, dataset.read("semantic", frames)[:, view])

        info = features[camera["depth_key"]]["info"]
        assert info["is_depth_map"] and info["video.use_log"] and info["video.shift"] == 0
        codes = pictures(export, "videos", camera["depth_key"], "gray12le")
        nearest, farthest = info["video.depth_min"], info["video.depth_max"]
        depth = np.exp(np.log(nearest) + codes / 4095 * np.log(farthest / nearest))  # as LeRobot reads it
        true = dataset.read("depth", frames)[:, view]
        hit = true < far
        background += int((~hit).sum())
        np.testing.assert_array_equal(codes == 4095, ~hit)
        error = largest_error(DepthCodes(nearest, farthest))
        assert error < 1e-3
        np.testing.assert_allclose(depth[hit], true[hit], rtol=1.01 * error)

        rgb = pictures(export, "videos", camera["image_key"], "rgb24")
        difference = np.abs(rgb.astype(int) - dataset.read("rgb", frames)[:, view])
        assert difference.mean() < 10  # colour is stored at half the resolution, and 24 pixels are few
    assert background > 0


def test_a_known_point_is_where_the_exported_matrices_say(dataset: MultiViewDataset, export: Path):
    frames, data = shown(dataset), table(export, "data")
    names = list(dataset.columns("privileged"))
    handle = data["privileged_state"][:, [names.index(f"handle_{axis}") for axis in "xyz"]]
    moving = 0
    for camera in read_json(export / "meta/cameras.json")["cameras"]:
        view = dataset.camera_names.index(camera["name"])
        poses = np.broadcast_to(np.array(camera["world_from_camera"] or 0.0), (len(frames), 4, 4))
        if camera["world_from_camera_key"]:
            poses = data[camera["world_from_camera_key"]]
            moving += 1
        camera_from_world = dataset.cameras(frames)[1][:, view]
        np.testing.assert_array_equal(poses.astype(np.float32), np.linalg.inv(camera_from_world).astype(np.float32))
        K = np.array(camera["intrinsics"])
        local = np.einsum("nij,nj->ni", np.linalg.inv(poses), np.c_[handle, np.ones(len(handle))])[:, :3] @ K.T
        pixels = local[:, :2] / local[:, 2:]
        expected, _ = project(dataset.projections(frames)[:, view], handle[:, None])
        np.testing.assert_allclose(pixels, expected[:, 0], atol=0.01)
    assert moving == 1


def test_the_cameras_are_the_encoders_first_and_named_as_in_lerobots_meta_world(export: Path):
    info, cameras = read_json(export / "meta/info.json"), read_json(export / "meta/cameras.json")
    assert [camera["name"] for camera in cameras["cameras"]] == ["left", "right", "random_0", "top"]
    assert [camera["image_key"] for camera in cameras["cameras"]][:2] == [
        "observation.image",
        "observation.images.right",
    ]
    assert info["codebase_version"] == "v3.0" and info["fps"] == RATE and info["robot_type"] == "metaworld"
    assert info["total_frames"] == EPISODES * STEPS and info["splits"] == {"train": f"0:{EPISODES}"}
    assert info["features"]["observation.image"]["shape"] == [SIZE, SIZE, 3]
    assert info["features"]["observation.state"]["shape"] == [4]
    assert info["features"]["next.done"]["dtype"] == "bool"
    tasks = parquet.read_table(export / "meta/tasks.parquet")
    assert tasks.to_pydict() == {"task_index": [0], "task": ["drawer open"]}
    assert json.loads(tasks.schema.metadata[b"pandas"])["index_columns"] == ["task"]


def test_episodes_tell_where_they_are_in_files_of_limited_length(
    dataset: MultiViewDataset, export: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.setattr(lerobot_part, "MOST_SECONDS", 2 * STEPS / RATE)
    out = exported(dataset, tmp_path / "out")
    episodes = table(out, "meta/episodes")
    key = "videos/observation.image"
    assert episodes[f"{key}/file_index"].tolist() == episodes["data/file_index"].tolist() == [0, 0, 1]
    np.testing.assert_allclose(episodes[f"{key}/from_timestamp"], [0, STEPS / RATE, 0])
    assert episodes["dataset_to_index"].tolist() == [STEPS, 2 * STEPS, 3 * STEPS]
    splits = dataset.read_splits(shown(dataset)[::STEPS])
    assert episodes["source/split"].tolist() == [("train", "validation")[split] for split in splits]
    for name, kind, pixels in (
        ("videos", "observation.images.left_depth", "gray12le"),
        ("labels", "observation.image", "gray"),
    ):
        np.testing.assert_array_equal(pictures(out, name, kind, pixels), pictures(export, name, kind, pixels))


def test_chosen_episodes_cameras_and_words(dataset: MultiViewDataset, tmp_path: Path):
    keys = [
        "--episodes",
        "[1]",
        "--cameras",
        "[top, left]",
        "--task",
        "Open a drawer",
        "--depth",
        "false",
        "--fps",
        "10",
    ]
    out = exported(dataset, tmp_path / "out", *keys)
    info = read_json(out / "meta/info.json")
    videos = [key for key, feature in info["features"].items() if feature["dtype"] == "video"]
    assert videos == ["observation.image", "observation.images.left"] and info["fps"] == 10
    assert table(out, "meta/episodes")["source/episode"].tolist() == [1]
    assert parquet.read_table(out / "meta/tasks.parquet")["task"].to_pylist() == ["Open a drawer"]


def test_statistics_are_those_of_the_dataset(dataset: MultiViewDataset, export: Path):
    frames, statistics = shown(dataset), read_json(export / "meta/stats.json")
    action = dataset.read("state/action", frames)
    for name, values in {
        "mean": action.mean(0),
        "std": action.std(0),
        "min": action.min(0),
        "max": action.max(0),
    }.items():
        np.testing.assert_allclose(statistics["action"][name], values, atol=1e-5)
    rgb = dataset.read("rgb", frames)[:, dataset.camera_names.index("left")] / 255
    np.testing.assert_allclose(np.ravel(statistics["observation.image"]["mean"]), rgb.mean((0, 1, 2)), atol=1e-6)
    np.testing.assert_allclose(np.ravel(statistics["observation.image"]["std"]), rgb.std((0, 1, 2)), atol=1e-6)
    assert np.shape(statistics["observation.images.left_depth"]["q99"]) == (1, 1, 1)


def test_a_histograms_statistics_are_those_of_its_values():
    levels = np.random.default_rng(0).integers(20, 200, (2, 5000))
    counts = np.stack([np.bincount(row, minlength=256) for row in levels])
    found = of_histograms(counts, np.arange(256.0), 7)
    expected = of_values(levels.T)
    for name in ("min", "max", "mean", "std"):
        np.testing.assert_allclose(found[name][:, 0, 0], expected[name])
    np.testing.assert_allclose(found["q10"][:, 0, 0], expected["q10"], atol=1)
    halves = together([of_values(levels.T[:1000]), of_values(levels.T[1000:])])
    np.testing.assert_allclose(halves["std"], expected["std"])


def test_depth_codes_keep_the_topmost_for_where_nothing_was_hit():
    codes = DepthCodes.for_range(0.5, 40.0)
    depth = np.geomspace(0.5, 40.0, 10_000).astype(np.float32)
    encoded = codes.encode(depth, hit=49.0)
    assert encoded.min() == 0 and encoded.max() == TOPMOST - 1
    assert (np.abs(codes.decode(encoded) / depth - 1) <= 1.01 * largest_error(codes)).all()
    assert codes.encode(np.array([49.5], np.float32), hit=49.0) == TOPMOST


def test_an_environment_that_ended_begins_another_episode(tmp_path: Path):
    keys = ["--episodes", "1", "--episode_steps", "80", "--frames_per_episode", "81", "--size", "16", "--workers", "1"]
    assert cli.main(["gen-dataset", "--scene", "gym/Hopper-v5", "--out", str(tmp_path / "hopper"), *keys]) == 0
    hopper = MultiViewDataset(tmp_path / "hopper")
    steps, episodes = hopper.read("step"), whole_episodes(hopper, [])
    assert len(episodes) > 1  # it fell
    for episode in episodes:
        assert episode.number == 0
        np.testing.assert_array_equal(steps[episode.states], np.arange(len(episode.states)))
    out = tmp_path / "out"
    assert cli.main(["export", str(hopper.folder), "--format", "lerobot", "--out", str(out)]) == 0
    assert read_json(out / "meta/info.json")["fps"] == 125
    assert table(out, "data")["next.done"].sum() == len(episodes)


def test_an_interrupted_export_leaves_no_dataset_and_can_be_begun_anew(
    dataset: MultiViewDataset, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    add = lerobot_part.Part.add

    def interrupted(self: Any, index: int, *arguments: Any) -> Any:
        if index == 2:
            raise KeyboardInterrupt
        return add(self, index, *arguments)

    monkeypatch.setattr(lerobot_part.Part, "add", interrupted)
    command = ["export", str(dataset.folder), "--format", "lerobot", "--out", str(tmp_path / "out")]
    assert cli.main(command) == 130
    left = sorted(path.name for path in (tmp_path / "out").rglob("*") if path.is_file())
    assert left == ["config.yaml", "provenance.json"]
    monkeypatch.undo()
    assert cli.main([*command, "--overwrite", "true"]) == 0
    assert (tmp_path / "out/meta/info.json").is_file() and not list((tmp_path / "out").rglob(".partial*"))


@pytest.mark.parametrize(
    "arguments, message",
    [
        (["--frames", "[1]"], "exports whole episodes as they were seen: leave out --frames"),
        (["--episodes", "[9]"], "has no episode 9; available: 0 to 2"),
        (["--cameras", "[lfet]"], "unknown camera 'lfet' (did you mean left"),
        (["--cameras", "[left, left]"], "names a camera twice"),
        (["--fps", "-1"], "--fps must be at least 0"),
    ],
)
def test_mistakes_are_told_in_a_sentence_and_nothing_is_written(
    dataset: MultiViewDataset, tmp_path: Path, capsys: pytest.CaptureFixture[str], arguments: list[str], message: str
):
    command = ["export", str(dataset.folder), "--format", "lerobot", "--out", str(tmp_path / "out"), *arguments]
    assert cli.main(command) == 2
    assert message in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


def test_pixels_that_do_not_count_are_refused_since_they_have_no_place(
    dataset: MultiViewDataset, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.setattr(MultiViewDataset, "read_valid", lambda self, frames: np.zeros((len(frames), 4, 24, 24), bool))
    assert cli.main(["export", str(dataset.folder), "--format", "lerobot", "--out", str(tmp_path / "out")]) == 2
    assert "has pixels that are masked or of unknown depth, for which LeRobot has no place" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


def test_scattered_frames_are_refused_with_how_to_keep_all(
    tiny_dataset: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
):
    command = ["export", str(tiny_dataset), "--format", "lerobot", "--out", str(tmp_path / "out")]
    assert cli.main(command) == 2
    assert "make a dataset with --episode_steps 12 --frames_per_episode 13" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


@pytest.mark.skipif(LEROBOT_PYTHON is None, reason="LEROBOT_PYTHON names no Python with LeRobot")
def test_lerobot_itself_reads_what_was_exported(dataset: MultiViewDataset, export: Path, tmp_path: Path):
    """LeRobot needs an older torch than this package, so that it runs in an environment of its own."""
    frames, chosen = shown(dataset), [0, 5, STEPS, 3 * STEPS - 1]
    dump = tmp_path / "read.npz"
    command = [str(LEROBOT_PYTHON), str(TOOL), str(export), "--dump", str(dump), "--frames", *map(str, chosen)]
    subprocess.run(command, check=True, env={**os.environ, "PYTHONPATH": ""})
    with np.load(dump) as read:
        np.testing.assert_array_equal(read["action"], dataset.read("state/action", frames[chosen]))
        for camera in read_json(export / "meta/cameras.json")["cameras"]:
            view = dataset.camera_names.index(camera["name"])
            true, depth = dataset.read("depth", frames[chosen])[:, view], read[camera["depth_key"]][:, 0]
            hit = true < 0.999 * dataset.manifest["far"]
            np.testing.assert_allclose(depth[hit], true[hit], rtol=1e-3)
            rgb = read[camera["image_key"]].transpose(0, 2, 3, 1) * 255
            assert np.abs(rgb - dataset.read("rgb", frames[chosen])[:, view]).mean() < 10
            if camera["world_from_camera_key"]:
                poses = np.linalg.inv(dataset.cameras(frames[chosen])[1][:, view])
                np.testing.assert_array_equal(read[camera["world_from_camera_key"]], poses.astype(np.float32))
