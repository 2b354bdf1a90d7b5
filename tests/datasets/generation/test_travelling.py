"""Datasets of a robot that travels: cameras go with it, and the frame in which they stand still is written down."""

import json
from pathlib import Path

import numpy as np
import pytest
from tiny_recipes import travelling_recipe

from nerf_rl import cli
from nerf_rl.cameras.geometry import camera_position, project
from nerf_rl.datasets.storage.frames import in_world, read_frame
from nerf_rl.datasets.storage.reader import MultiViewDataset
from nerf_rl.errors import MissingFileError, UserError


def test_the_frame_goes_with_the_robot_and_cameras_stand_still_in_it(travelling_dataset: Path):
    dataset = MultiViewDataset(travelling_dataset)
    frames = np.arange(len(dataset))
    frame = dataset.tracking_frame
    assert frame is not None and (frame.body, frame.axes) == ("torso", "xy")
    torso = dataset.read("state/privileged")
    assert np.ptp(torso[:, 0]) > 0.05  # it has come some way
    np.testing.assert_allclose(dataset.tracking_origins(frames), torso * [1, 1, 0], atol=1e-6)
    encoder = dataset.views("encoder")
    (_, world), (_, own) = dataset.cameras(frames), dataset.tracked_cameras(frames)
    assert np.ptp(camera_position(world)[:, encoder, 0], axis=0).min() > 0.05
    assert np.ptp(own[:, encoder], axis=0).max() < 1e-9
    np.testing.assert_allclose(dataset.tracked_positions(frames), torso * [0, 0, 1], atol=1e-6)


def test_the_robot_stays_in_view(travelling_dataset: Path):
    dataset = MultiViewDataset(travelling_dataset)
    frames = np.arange(len(dataset))
    for view in dataset.views("encoder"):
        assert (dataset.read_labels(frames)[:, view] == dataset.class_names.index("robot")).any((1, 2)).all()
    projections, torso = dataset.projections(frames), dataset.read("state/privileged").astype(np.float64)
    for view in dataset.views("encoder"):
        pixels, depth = project(projections[:, view], torso[:, None])
        assert depth.min() > 0 and np.abs(pixels - 12).max() < 8


def test_a_frame_to_look_at_is_in_the_tracking_frame_and_can_be_had_in_the_world(travelling_dataset: Path):
    dataset = MultiViewDataset(travelling_dataset)
    last = len(dataset) - 1
    shown = read_frame(dataset, last)
    np.testing.assert_allclose(shown.camera_from_world, dataset.tracked_cameras([last])[1][0])
    assert shown.points["torso"][0] == pytest.approx(0.0, abs=1e-6) and shown.origin[0] != 0
    world = in_world(shown)
    np.testing.assert_allclose(world.camera_from_world, dataset.cameras([last])[1][0], atol=1e-12)
    np.testing.assert_allclose(world.points["torso"], dataset.read("state/privileged", [last])[0], atol=1e-6)


def test_it_is_checked_and_exported_as_any_other(travelling_dataset: Path, tmp_path: Path):
    assert cli.main(["check", str(travelling_dataset)]) == 0
    out = tmp_path / "scenes"
    assert cli.main(["export", str(travelling_dataset), "--out", str(out), "--frames", "[5]"]) == 0
    (transforms,) = out.rglob("transforms.json")
    first = json.loads(transforms.read_text())["frames"][0]["transform_matrix"]
    positions = camera_position(MultiViewDataset(travelling_dataset).cameras([5])[1][0])
    assert min(np.abs(positions - np.array(first)[:3, 3]).max(1)) < 1e-6  # one of the cameras, in the world


def test_following_can_be_forced_either_way(tmp_path: Path):
    recipe, out = tmp_path / "data.yaml", tmp_path / "data"
    recipe.write_text(travelling_recipe(episodes=2))
    words = ["gen-dataset", "--config", str(recipe), "--out", str(out), "--overwrite", "true"]
    assert cli.main([*words, "--rig.follow", "none"]) == 0
    dataset = MultiViewDataset(out)
    assert dataset.tracking_frame is None
    with pytest.raises(UserError, match="unknown array"):
        dataset.read("cameras/tracking_origin")
    assert cli.main([*words, "--rig.follow", "ffoot", "--rig.follow_axes", "xyz"]) == 0
    frame = MultiViewDataset(out).tracking_frame
    assert frame is not None and (frame.body, frame.axes) == ("ffoot", "xyz")


@pytest.mark.parametrize(
    "name, joint, follow, warned",
    [
        ("", "", "auto", True),
        ("", "", "none", False),
        ("", 'range="-1 1"', "auto", False),
        ('name="base"', "", "auto", False),
    ],
)
@pytest.mark.parametrize("estimate", ["true", "false"])
def test_a_robot_that_is_not_followed_for_want_of_a_name_is_told(
    name: str, joint: str, follow: str, warned: bool, estimate: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
):
    (tmp_path / "cart.xml").write_text(
        f"""<mujoco><worldbody><light pos="0 0 3"/><geom type="plane" size="9 9 0.1" rgba="0.2 0.4 0.6 1"/>
        <body {name} pos="0 0 0.2"><joint name="x" type="slide" {joint}/><geom type="box" size="0.2 0.1 0.1"/></body>
        </worldbody><actuator><motor joint="x"/></actuator></mujoco>"""
    )
    words = ["gen-dataset", "--scene", str(tmp_path / "cart.xml"), "--out", str(tmp_path / "data"), "--size", "16"]
    words += ["--episodes", "1", "--frames_per_episode", "1", "--episode_steps", "1", "--workers", "1"]
    assert cli.main([*words, "--rig.follow", follow, "--estimate", estimate]) == 0
    said = capsys.readouterr().err
    assert said.count("since its root, body 1, has no name; give it one in the model") == int(warned)


@pytest.mark.parametrize("frame", [{"body": 3, "axes": "xy"}, {"body": "torso", "axes": "z"}, {"body": "torso"}, None])
def test_a_manifest_with_a_strange_frame_is_damaged(frame: object, travelling_dataset: Path, tmp_path: Path):
    manifest = json.loads((travelling_dataset / "manifest.json").read_text())
    del manifest["checksum"]
    (tmp_path / "manifest.json").write_text(json.dumps({**manifest, "tracking_frame": frame}))
    with pytest.raises(MissingFileError, match=r"manifest\.json is damaged.*tracking_frame"):
        MultiViewDataset(tmp_path)
