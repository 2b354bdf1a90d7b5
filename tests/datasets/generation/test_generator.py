"""Dataset generation, run as the command runs it: the same bytes however it is done, and what the format promises."""

import json
import re
import shutil
from pathlib import Path

import h5py
import mujoco
import numpy as np
import pytest
from tiny_recipes import TINY_DATASET

from nerf_rl import cli
from nerf_rl.datasets.generation.shard_episodes import open_render_context
from nerf_rl.datasets.generation.unfinished import OutputRecord
from nerf_rl.datasets.storage.reader import MultiViewDataset
from nerf_rl.datasets.storage.shards import MANIFEST, SHARDS, sha256_of
from nerf_rl.datasets.storage.splits import validation_episodes
from nerf_rl.errors import UserError
from nerf_rl.files.outputs import PROVENANCE

EPISODES, FRAMES_PER_EPISODE, STEPS, SIZE, VIEWS = 4, 3, 12, 24, 4


def shard_bytes(folder: Path) -> dict[str, bytes]:
    """Return the content of each file beside the shards, hidden ones included."""
    return {path.name: path.read_bytes() for path in sorted((folder / SHARDS).iterdir())}


def generate(recipe: Path, out: Path, *arguments: str) -> int:
    return cli.main(["gen-dataset", "--config", str(recipe), "--out", str(out), *arguments])


def content_of(folder: Path) -> dict[str, bytes]:
    """Return every file below a folder."""
    return {str(path.relative_to(folder)): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def test_two_workers_write_the_same_bytes_as_one(tiny_dataset: Path, tiny_recipe: Path, tmp_path: Path):
    assert generate(tiny_recipe, tmp_path / "two", "--workers", "2") == 0
    assert shard_bytes(tmp_path / "two") == shard_bytes(tiny_dataset)
    assert len(shard_bytes(tiny_dataset)) == 2
    manifests = [json.loads((folder / MANIFEST).read_text()) for folder in (tiny_dataset, tmp_path / "two")]
    assert manifests[0] == manifests[1]


def test_an_interrupted_run_resumes_to_the_same_bytes(tiny_dataset: Path, tiny_recipe: Path, tmp_path: Path):
    folder = tmp_path / "interrupted"
    shutil.copytree(tiny_dataset, folder)
    for lost in (MANIFEST, "summary.json", f"{SHARDS}/000001.h5"):
        (folder / lost).unlink()
    (folder / SHARDS / ".000001.h5.4711.partial").write_bytes(b"half a shard")
    kept = (folder / SHARDS / "000000.h5").stat()
    assert generate(tiny_recipe, folder, "--resume", "true") == 0
    assert shard_bytes(folder) == shard_bytes(tiny_dataset)
    assert (folder / SHARDS / "000000.h5").stat().st_mtime_ns == kept.st_mtime_ns
    assert (folder / MANIFEST).read_bytes() == (tiny_dataset / MANIFEST).read_bytes()
    summary = json.loads((folder / "summary.json").read_text())
    assert summary["frames"] == EPISODES * FRAMES_PER_EPISODE


def test_an_existing_dataset_is_refused_and_left_alone(
    tiny_dataset: Path, tiny_recipe: Path, capsys: pytest.CaptureFixture[str]
):
    before = content_of(tiny_dataset)
    assert generate(tiny_recipe, tiny_dataset) == 2
    message = capsys.readouterr().err
    assert "already exists and is not empty; use --resume true, --overwrite true or another --out" in message
    assert message.count("\n") == 1
    assert content_of(tiny_dataset) == before


def test_resuming_with_another_version_of_the_scene_is_refused(tiny_dataset: Path, tiny_recipe: Path):
    config = cli.parse("gen-dataset", ["--config", str(tiny_recipe), "--out", str(tiny_dataset), "--resume", "true"])
    scene = json.loads((tiny_dataset / MANIFEST).read_text())["scene"]
    assert list(OutputRecord(config).finished_shards(scene)) == [0, 1]
    for other in ({**scene, "mujoco": "2.0"}, {**scene, "another": 1}, {"name": scene["name"]}):
        with pytest.raises(
            UserError, match=r"another version of the scene \(what differs: (mujoco|another|.*, mujoco)"
        ):
            OutputRecord(config).finished_shards(other)


def test_a_model_that_was_edited_since_leaves_finished_shards_alone(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    scene = tmp_path / "blocks.xml"
    shutil.copy("datasets/scenes/blocks.xml", scene)
    (tmp_path / "data.yaml").write_text(
        TINY_DATASET.replace("metaworld/drawer-open-v3", str(scene)).partition("rig:")[0]
    )
    assert generate(tmp_path / "data.yaml", tmp_path / "data") == 0
    before = content_of(tmp_path / "data")
    scene.write_text(scene.read_text().replace('mass="0.05"', 'mass="0.06"'))
    capsys.readouterr()
    assert generate(tmp_path / "data.yaml", tmp_path / "data", "--resume", "true") == 2
    said = capsys.readouterr().err
    assert "shards/000000.h5 is of another" in said and "(what differs: model_sha256)" in said and said.count("\n") == 1
    assert content_of(tmp_path / "data") == before


def test_a_folder_below_a_file_is_refused_in_a_sentence(
    tiny_recipe: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
):
    (tmp_path / "file").touch()
    assert generate(tiny_recipe, tmp_path / "file" / "data") == 2
    said = capsys.readouterr().err
    assert f"{tmp_path / 'file'} is a file and no folder" in said and said.count("\n") == 1


def test_resuming_with_another_configuration_is_refused(
    tiny_dataset: Path, tiny_recipe: Path, capsys: pytest.CaptureFixture[str]
):
    before = content_of(tiny_dataset)
    assert generate(tiny_recipe, tiny_dataset, "--resume", "true", "--seed", "4") == 2
    assert "was begun with another configuration (what differs: seed); " in capsys.readouterr().err
    assert content_of(tiny_dataset) == before


def test_a_folder_of_someone_else_is_not_overwritten(
    tiny_recipe: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
):
    (tmp_path / "thesis.tex").write_text("years of work")
    assert generate(tiny_recipe, tmp_path, "--overwrite", "true") == 2
    assert f"it holds no {PROVENANCE}" in capsys.readouterr().err
    assert content_of(tmp_path) == {"thesis.tex": b"years of work"}


@pytest.mark.parametrize(
    "arguments, words",
    [
        (["--rig.encoder", "[lfet]"], "unknown encoder camera 'lfet' (did you mean left"),
        (["--scene", "metaworld/drawer-opne-v3"], "unknown Meta-World task 'drawer-opne-v3' (did you mean drawer-open"),
        (["--scene", "nowhere"], "unknown scene 'nowhere'; available: metaworld/TASK"),
        (["--classes", "[{name: window, pattern: glass}]"], "class 'window': no geom matches 'glass'"),
        (["--frames_per_episode", "14"], "--frames_per_episode 14"),
        (["--quality", "best"], "unknown quality 'best' (did you mean fast?); available: fast, full, smooth"),
        (["--rig.follow_axes", "up"], "unknown rig.follow_axes 'up'; available: xy, xyz"),
    ],
)
def test_a_mistake_is_one_sentence_and_nothing_is_written(
    tiny_recipe: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], arguments: list[str], words: str
):
    assert generate(tiny_recipe, tmp_path / "out", *arguments) == 2
    message = capsys.readouterr().err
    assert words in message
    assert message.count("\n") == 1
    assert not list(tmp_path.iterdir())


def test_a_camera_that_sees_nothing_is_named_with_episode_and_step(
    tiny_recipe: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
):
    cameras = "[{name: left, azimuth: 20, elevation: -30}, {name: astray, lookat: [0, 0, -90], elevation: -80}]"
    arguments = ["--rig.cameras", cameras, "--rig.encoder", "[left]", "--rig.test", "[]", "--estimate", "true"]
    assert generate(tiny_recipe, tmp_path / "out", *arguments) == 1
    message = capsys.readouterr().err
    assert re.search(
        r"episode 0, step \d+: camera astray sees nothing: its picture is of one colour at one depth", message
    )
    assert message.count("\n") == 1


def test_the_summary_has_its_figures(tiny_dataset: Path):
    summary = json.loads((tiny_dataset / "summary.json").read_text())
    assert set(summary) == {"frames", "views", "seconds", "views_per_second", "renderer", "worker_peak_rss_mb"}
    assert summary["frames"] == EPISODES * FRAMES_PER_EPISODE and summary["views"] == summary["frames"] * VIEWS
    assert summary["views_per_second"] == pytest.approx(summary["views"] / summary["seconds"], rel=0.02)
    assert summary["renderer"] and 50 < summary["worker_peak_rss_mb"] < 1000


def test_the_manifest_describes_the_shards(tiny_dataset: Path):
    manifest = json.loads((tiny_dataset / MANIFEST).read_text())
    for entry in manifest["shards"]:
        assert sha256_of(tiny_dataset / entry["file"]) == entry["sha256"]
        with h5py.File(tiny_dataset / entry["file"]) as file:
            assert len(file["rgb"]) == entry["frames"]
    assert manifest["frames"] == EPISODES * FRAMES_PER_EPISODE
    roles = {camera["name"]: camera["role"] for camera in manifest["cameras"]}
    assert roles == {"top": "test", "left": "encoder", "right": "encoder", "random_0": "supervision"}
    classes = [entry["name"] for entry in manifest["classes"]]
    assert classes[0] == "background" and {"drawer", "gripper"} < set(classes)
    assert manifest["scene"]["name"] == "metaworld/drawer-open-v3" and manifest["config"]["seed"] == 3
    assert manifest["renderer"] and manifest["packages"]["mujoco"] and manifest["height"] == manifest["width"] == SIZE


def test_a_shard_is_plain_hdf5_with_every_documented_array(tiny_dataset: Path):
    n = 2 * FRAMES_PER_EPISODE
    image = (n, VIEWS, SIZE, SIZE)
    with h5py.File(tiny_dataset / SHARDS / "000000.h5") as file:
        model_bodies = file["state/body_pos"].shape[1]
        expected = {
            "rgb": ((*image, 3), "uint8"),
            "depth": (image, "float32"),
            "semantic": (image, "uint8"),
            "episode": ((n,), "int32"),
            "step": ((n,), "int32"),
            "split": ((n,), "uint8"),
            "cameras/intrinsics": ((VIEWS, 3, 3), "float64"),
            "cameras/camera_from_world": ((n, VIEWS, 4, 4), "float64"),
            "cameras/projection": ((n, VIEWS, 3, 4), "float64"),
            "state/qpos": ((n, 10), "float64"),
            "state/qvel": ((n, 10), "float64"),
            "state/mocap_pos": ((n, 1, 3), "float64"),
            "state/mocap_quat": ((n, 1, 4), "float64"),
            "state/body_pos": ((n, model_bodies, 3), "float64"),
            "state/body_quat": ((n, model_bodies, 4), "float64"),
            "state/action": ((n, 4), "float32"),
            "state/proprio": ((n, 4), "float32"),
            "state/privileged": ((n, 9), "float32"),
            "reward": ((n,), "float32"),
            "success": ((n,), "uint8"),
        }
        found = {}
        file.visititems(lambda name, item: found.update({name: item}) if isinstance(item, h5py.Dataset) else None)
        assert {name: (array.shape, str(array.dtype)) for name, array in found.items()} == expected
        assert all(array.chunks is None and array.compression is None for array in found.values())


def test_the_projection_is_intrinsics_times_extrinsics(tiny_dataset: Path):
    with h5py.File(tiny_dataset / SHARDS / "000001.h5") as file:
        intrinsics, poses = file["cameras/intrinsics"][:], file["cameras/camera_from_world"][:]
        for frame, view in np.ndindex(*poses.shape[:2]):
            expected = intrinsics[view] @ poses[frame, view, :3]
            np.testing.assert_allclose(file["cameras/projection"][frame, view], expected, atol=1e-9)
        moved = np.ptp(poses, axis=0).max(axis=(1, 2)) > 1e-3
    np.testing.assert_array_equal(moved, [False, False, False, True])


def test_an_episode_is_in_one_split(tiny_dataset: Path):
    dataset = MultiViewDataset(tiny_dataset)
    episode = dataset.read("episode")
    np.testing.assert_array_equal(episode, np.repeat(np.arange(EPISODES), FRAMES_PER_EPISODE))
    train, validation = (set(episode[dataset.split(name)].tolist()) for name in ("train", "validation"))
    assert len(train) == 3 and len(validation) == 1 and not train & validation


@pytest.mark.parametrize(
    "episodes, fraction, expected", [(10, 0.0, 0), (10, 0.3, 3), (2, 0.01, 1), (2, 0.99, 1), (1, 0.5, 0)]
)
def test_the_share_of_held_out_episodes_is_what_was_asked_for(episodes: int, fraction: float, expected: int):
    chosen = {validation_episodes(episodes, fraction, seed) for seed in range(20)}
    assert {len(held_out) for held_out in chosen} == {expected}
    assert all(held_out <= set(range(episodes)) for held_out in chosen)
    assert len(chosen) > 1 or expected == 0


def test_steps_rewards_and_actions_are_those_of_episodes(tiny_dataset: Path):
    dataset = MultiViewDataset(tiny_dataset)
    steps = dataset.read("step").reshape(EPISODES, FRAMES_PER_EPISODE)
    assert steps.min() >= 0 and steps.max() <= STEPS
    assert (np.diff(steps, axis=1) > 0).all()
    assert len(np.unique(steps, axis=0)) > 1
    reward = dataset.read("reward").reshape(steps.shape)
    assert ((reward == 0) == (steps == 0)).all() and np.isfinite(reward).all()
    assert np.abs(dataset.read("state/action")).max() <= 1
    assert set(np.unique(dataset.read("success"))) <= {0, 1}


def test_named_columns_hold_what_their_names_say(tiny_dataset: Path):
    dataset = MultiViewDataset(tiny_dataset)
    privileged = dict(zip(dataset.columns("privileged"), dataset.read("state/privileged").T, strict=True))
    proprio = dict(zip(dataset.columns("proprio"), dataset.read("state/proprio").T, strict=True))
    for axis in "xyz":
        np.testing.assert_array_equal(privileged[f"hand_{axis}"], proprio[f"hand_{axis}"])
    drawer = dataset.manifest["bodies"].index("drawer")
    drawer_x = dataset.read("state/body_pos")[:, drawer, 0]
    np.testing.assert_allclose(privileged["handle_x"], drawer_x, atol=1e-3)
    assert len(np.unique(drawer_x)) == EPISODES


def test_the_stored_state_renders_to_the_stored_images(tiny_dataset: Path, tiny_recipe: Path):
    dataset = MultiViewDataset(tiny_dataset)
    config = cli.parse("gen-dataset", ["--config", str(tiny_recipe), "--out", "unused"])
    context = open_render_context(config)
    model, data = context.scene.model, context.scene.data
    context.scene.env.reset(seed=99)
    for frame in range(len(dataset)):
        state = {name: dataset.read(f"state/{name}", [frame])[0] for name in ("body_pos", "body_quat", "qpos", "qvel")}
        model.body_pos[:], model.body_quat[:] = state["body_pos"], state["body_quat"]
        data.qpos[:], data.qvel[:] = state["qpos"], state["qvel"]
        mujoco.mj_forward(model, data)
        views = context.renderer.render(data, dataset.cameras([frame])[0], dataset.cameras([frame])[1][0])
        np.testing.assert_array_equal(views.rgb, dataset.read("rgb", [frame])[0])
        np.testing.assert_array_equal(views.depth, dataset.read("depth", [frame])[0])
        np.testing.assert_array_equal(context.classes.label(views.geom), dataset.read("semantic", [frame])[0])
    context.renderer.close()
