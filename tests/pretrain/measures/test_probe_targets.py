"""What probes look for: joints of a scene as numbers without jumps, and errors in millimetres and degrees."""

import mujoco
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from nerf_rl import cli
from nerf_rl.datasets.storage.reader import MultiViewDataset
from nerf_rl.errors import UserError
from nerf_rl.pretrain.measures.probe_targets import (
    angle_error,
    joint_targets,
    length_error,
    orientation_error,
    rotation_matrices,
    varying,
)
from nerf_rl.scenes.make import make_scene

BLOCKS = "datasets/scenes/blocks.xml"


@pytest.fixture(scope="module")
def blocks(tmp_path_factory: pytest.TempPathFactory) -> MultiViewDataset:
    """A dataset of an arm with hinges and of blocks that lie about freely."""
    out = tmp_path_factory.mktemp("blocks") / "data"
    few = ["--episodes", "3", "--frames_per_episode", "3", "--episode_steps", "12", "--size", "16", "--workers", "1"]
    assert cli.main(["gen-dataset", "--scene", BLOCKS, *few, "--out", str(out)]) == 0
    return MultiViewDataset(out)


def test_lengths_are_told_in_millimetres():
    np.testing.assert_allclose(length_error(np.array([[0.1], [0.2]]), np.array([[0.103], [0.19]])), [3.0, -10.0])


def test_angles_differ_by_the_shorter_way_round_whatever_the_length_of_what_was_read():
    truth, read = np.radians([170.0, 10.0, -90.0]), np.radians([-175.0, 350.0, -60.0])

    def circle(angles: np.ndarray, radius: float = 1.0) -> np.ndarray:
        return radius * np.stack([np.cos(angles), np.sin(angles)], axis=1)

    np.testing.assert_allclose(angle_error(circle(truth), circle(read, 0.7)), [15.0, -20.0, 30.0])


def test_orientations_differ_by_the_angle_of_the_rotation_between_them():
    rng = np.random.default_rng(0)
    truth, read = (Rotation.random(50, random_state=rng) for _ in range(2))
    matrices = [rotation.as_matrix().reshape(-1, 9) for rotation in (truth, read)]
    expected = np.degrees((truth.inv() * read).magnitude())
    np.testing.assert_allclose(orientation_error(*matrices), expected, atol=1e-4)
    np.testing.assert_allclose(orientation_error(matrices[0], 0.3 * matrices[1]), expected, atol=1e-4)


def test_what_is_no_rotation_stands_for_the_nearest_one():
    rng = np.random.default_rng(1)
    truth = Rotation.random(30, random_state=rng).as_matrix().reshape(-1, 9)
    read = truth + 0.4 * rng.normal(size=truth.shape)
    expected = []
    for matrix, other in zip(truth.reshape(-1, 3, 3), read.reshape(-1, 3, 3), strict=True):
        nearest, _ = Rotation.align_vectors(
            other.T, np.eye(3)
        )  # the rotation that turns the axes into its columns best
        expected.append(np.degrees((Rotation.from_matrix(matrix).inv() * nearest).magnitude()))
    np.testing.assert_allclose(orientation_error(truth, read), expected, atol=1e-3)


def test_a_quaternion_and_its_negative_are_one_orientation():
    quaternions = np.random.default_rng(2).normal(size=(20, 4))
    expected = np.empty((20, 9))
    for row, quaternion in zip(expected, quaternions, strict=True):
        mujoco.mju_quat2Mat(row, quaternion / np.linalg.norm(quaternion))
    for sign in (1.0, -1.0):
        np.testing.assert_allclose(rotation_matrices(sign * quaternions).reshape(-1, 9), expected, atol=1e-12)


def test_the_joints_of_a_scene_are_named_and_have_the_values_of_the_simulation(blocks: MultiViewDataset):
    frames = np.arange(len(blocks))
    targets = {target.name: target for target in joint_targets(blocks, frames)}
    scene = make_scene(BLOCKS)
    for i, qpos in enumerate(blocks.read("state/qpos", frames)):
        scene.set_state(qpos, np.zeros(scene.model.nv))
        elbow = scene.data.joint("elbow").qpos[0]
        np.testing.assert_allclose(targets["elbow"].values[i], [np.cos(elbow), np.sin(elbow)], atol=1e-12)
        orientation = scene.data.body("green_block").xmat
        np.testing.assert_allclose(targets["green_block_orientation"].values[i], orientation, atol=1e-9)
    assert targets["elbow"].unit == targets["green_block_orientation"].unit == "deg"
    assert {name for name, target in targets.items() if target.unit == "mm"} == {"left", "right"}


def test_what_stands_still_is_left_out(blocks: MultiViewDataset):
    first = joint_targets(blocks, np.arange(3))
    names = [target.name for target in first]
    assert varying(first, joint_targets(blocks, np.array([0, 0]))) == []
    assert "elbow" in [names[i] for i in varying(first, joint_targets(blocks, np.arange(3, 9)))]


def test_a_dataset_of_before_joints_were_named_has_none(blocks: MultiViewDataset):
    older = MultiViewDataset(blocks.folder)
    del older.manifest["joints"]
    assert joint_targets(older, np.arange(3)) == []


def test_joints_of_another_scene_are_told(blocks: MultiViewDataset):
    damaged = MultiViewDataset(blocks.folder)
    damaged.manifest["joints"] = damaged.manifest["joints"][1:]
    with pytest.raises(UserError, match="its joints are not those of its state"):
        joint_targets(damaged, np.arange(3))
