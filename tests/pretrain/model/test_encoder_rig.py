"""The encoder's rig: found in a dataset, compared, stored."""

import dataclasses
import json
from pathlib import Path

import numpy as np
import pytest

from nerf_rl.cameras import geometry as cameras
from nerf_rl.cameras.tracking_frame import TrackingFrame
from nerf_rl.datasets.storage.reader import MultiViewDataset
from nerf_rl.errors import RigMismatchError, UserError
from nerf_rl.pretrain.model.encoder_rig import EncoderRig


def make_rig() -> EncoderRig:
    poses = [cameras.look_at(np.array([0.0, 0.6, 0.1]), 0.9, 20.0 + 60 * i, -30.0) for i in range(3)]
    intrinsics = np.stack([cameras.intrinsics_from_fovy(45.0, 16, 16)] * 3)
    return EncoderRig(("left", "right", "top"), intrinsics, np.stack(poses), 16, 16)


@pytest.mark.parametrize(
    "change, words",
    [
        (
            {"names": ("left", "right", "back")},
            r"names \('left', 'right', 'top'\) there, \('left', 'right', 'back'\) here",
        ),
        ({"height": 32}, "height 16 there, 32 here"),
        (
            {"intrinsics": make_rig().intrinsics * np.array([1, 1, 1.01])[:, None, None]},
            "camera 'top' has another intrinsics",
        ),
        (
            {"camera_from_world": make_rig().camera_from_world + 0.01 * np.eye(3)[1][:, None, None]},
            "camera 'right' has another camera_from_world",
        ),
    ],
)
def test_another_rig_is_answered_with_the_first_difference(change: dict, words: str):
    with pytest.raises(RigMismatchError, match=f"trained on another camera rig: {words}"):
        make_rig().require_same(dataclasses.replace(make_rig(), **change))


def test_the_same_rig_is_accepted():
    make_rig().require_same(make_rig())


def test_a_stored_rig_is_the_same_rig():
    stored = json.loads(json.dumps(make_rig().to_json()))
    rig = EncoderRig.from_json(stored)
    rig.require_same(make_rig())
    np.testing.assert_array_equal(rig.projections, make_rig().projections)
    assert rig.projections.dtype == np.float32


def test_a_rig_that_follows_is_stored_and_told_from_one_that_stands_still_or_follows_another_body():
    following = dataclasses.replace(make_rig(), tracking_frame=TrackingFrame("torso"))
    EncoderRig.from_json(json.loads(json.dumps(following.to_json()))).require_same(following)
    assert "tracking_frame" not in make_rig().to_json()  # so that earlier versions read it
    with pytest.raises(RigMismatchError, match="cameras follow torso along xy there, stand still here"):
        following.require_same(make_rig())
    other = dataclasses.replace(make_rig(), tracking_frame=TrackingFrame("torso", "xyz"))
    with pytest.raises(RigMismatchError, match="cameras follow torso along xyz there, follow torso along xy here"):
        other.require_same(following)


def test_the_rig_of_a_robot_that_travels_is_where_its_cameras_are_in_the_tracking_frame(travelling_dataset: Path):
    dataset = MultiViewDataset(travelling_dataset)
    rig = EncoderRig.of_dataset(dataset)
    assert rig.tracking_frame == dataset.tracking_frame
    height = float(dataset.read("state/privileged")[:, 2].mean())
    frame = len(dataset) - 1
    origin = dataset.tracking_origins([frame])[0]
    for view, (here, there) in enumerate(zip(rig.projections, dataset.projections([frame])[0], strict=False)):
        point = np.array([0.1, -0.2, height])
        inside = cameras.project(here.astype(np.float64), point[None])[0]
        np.testing.assert_allclose(
            inside, cameras.project(there, (point + origin)[None])[0], atol=1e-3, err_msg=f"{view}"
        )


def test_the_rig_is_the_encoders_cameras(tiny_dataset: Path):
    dataset = MultiViewDataset(tiny_dataset)
    rig = EncoderRig.of_dataset(dataset)
    assert rig.names == ("left", "right") and (rig.height, rig.width) == (24, 24)
    np.testing.assert_allclose(rig.projections, dataset.projections([0])[0, [1, 2]], rtol=1e-5, atol=1e-5)


def test_encoder_cameras_that_move_are_refused(tiny_dataset: Path):
    dataset = MultiViewDataset(tiny_dataset)
    dataset.manifest["cameras"][3]["role"] = "encoder"
    with pytest.raises(UserError, match="the encoder's cameras move, but an encoder needs fixed ones"):
        EncoderRig.of_dataset(dataset)


def test_cameras_that_move_and_come_back_do_not_stand_still(tiny_dataset: Path, monkeypatch: pytest.MonkeyPatch):
    dataset = MultiViewDataset(tiny_dataset)
    names = EncoderRig.of_dataset(dataset).names
    real = dataset.cameras

    def moving(frames: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        intrinsics, poses = real(frames)
        poses[np.asarray(frames) == 5, dataset.views("encoder")[0], 0, 3] += 0.1
        return intrinsics, poses

    monkeypatch.setattr(dataset, "cameras", moving)
    assert len(dataset) > 6 and names == ("left", "right")
    with pytest.raises(UserError, match="the encoder's cameras move"):
        EncoderRig.of_dataset(dataset)
    monkeypatch.setattr("nerf_rl.pretrain.model.encoder_rig._FRAMES_AT_ONCE", 5)
    with pytest.raises(UserError, match="the encoder's cameras move"):
        EncoderRig.of_dataset(dataset)
