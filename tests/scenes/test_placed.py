"""What an environment puts elsewhere in each episode without a joint is a thing to be seen, as what moves is."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from own_environments import DM_CONTROL, TARGET_SLIDER, TargetSlider, with_dm_control
from tiny_recipes import TINY_DATASET

from nerf_rl import cli
from nerf_rl.datasets.storage.reader import MultiViewDataset
from nerf_rl.rendering.semantics import semantic_classes
from nerf_rl.scenes.make import make_scene

REACHER = DM_CONTROL.replace("cartpole-balance", "reacher-easy")


def test_targets_are_found_wherever_an_environment_writes_their_places():
    scene = make_scene(TARGET_SLIDER)
    classes = semantic_classes(scene.model, scene.parts)
    assert set(classes.names) == {"background", "robot", "shelf", *TargetSlider.PLACED}
    columns = [f"{name}_{axis}" for name in TargetSlider.PLACED for axis in "xyz"]
    assert scene.privileged_names == ("cart_x", "cart_y", "cart_z", *columns)
    made: Any = scene.env.unwrapped
    for seed in (3, 4):
        scene.env.reset(seed=seed)
        np.testing.assert_allclose(scene.privileged(None)[3:], made.places.ravel())
    ball = scene.workspace()
    corners = np.array([[x, y, z] for x in (-0.4, 0.4) for y in (-0.4, 0.4) for z in (0.1, 0.4)])
    assert (np.linalg.norm(corners - ball.centre, axis=1) < ball.radius).all() and ball.radius < 1.2  # no table


def test_a_scene_that_looked_for_targets_is_as_after_its_first_reset():
    scene, alone = make_scene(TARGET_SLIDER), TargetSlider()
    alone.reset(seed=0)
    made: Any = scene.env.unwrapped
    for mine, theirs in ((scene.model.geom_pos, alone.model.geom_pos), (scene.data.mocap_pos, alone.data.mocap_pos)):
        np.testing.assert_array_equal(mine, theirs)
    np.testing.assert_array_equal(made.goal, alone.goal)


@pytest.mark.parametrize(
    "scene, name", [(TARGET_SLIDER, "disc"), pytest.param(REACHER, "target", marks=with_dm_control)]
)
def test_a_dataset_labels_a_target_where_it_is(scene: str, name: str, tmp_path: Path):
    (tmp_path / "data.yaml").write_text(TINY_DATASET.replace("metaworld/drawer-open-v3", scene).partition("rig:")[0])
    words = ["--config", str(tmp_path / "data.yaml"), "--out", str(tmp_path / "data"), "--size", "48"]
    assert cli.main(["gen-dataset", *words]) == 0
    dataset = MultiViewDataset(tmp_path / "data")
    frames, number = np.arange(len(dataset)), dataset.class_names.index(name)
    shown = dataset.read_labels(frames) == number
    assert (shown.sum((2, 3)) > 0).all()  # in each view of each frame
    assert len(np.unique(shown[:, 0], axis=0)) > 1  # and not always in one place
