"""Cameras of the model that an environment changes at resets: pictures and stored poses would not agree."""

from pathlib import Path

import numpy as np
import pytest
from tiny_recipes import TINY_DATASET

from nerf_rl import cli
from nerf_rl.datasets.storage.reader import MultiViewDataset

RECIPE = TINY_DATASET.partition("rig:")[0] + "episodes_per_shard: 1\n"
LENS = "gym/own_environments:{}LensSlider-v0"


@pytest.mark.parametrize(
    ("what", "words"),
    [("Moved", "moves camera lens of its model"), ("Zoomed", "changes the field of view of its camera 'lens'")],
)
def test_a_dataset_by_such_a_camera_is_refused(
    what: str, words: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
):
    recipe = RECIPE.replace("metaworld/drawer-open-v3", LENS.format(what))
    (tmp_path / "data.yaml").write_text(
        recipe + "rig: {cameras: [{name: still, camera: still}, {name: lens, camera: lens}]}\n"
    )
    assert cli.main(["gen-dataset", "--config", str(tmp_path / "data.yaml"), "--out", str(tmp_path / "data")]) == 1
    said = capsys.readouterr().err
    assert words in said and "leave that camera out" in said and "Traceback" not in said


def test_beside_such_a_camera_others_may_look(tmp_path: Path):
    recipe = RECIPE.replace("metaworld/drawer-open-v3", LENS.format("Moved"))
    (tmp_path / "data.yaml").write_text(recipe + "rig: {cameras: [{name: above, camera: still}]}\n")
    assert cli.main(["gen-dataset", "--config", str(tmp_path / "data.yaml"), "--out", str(tmp_path / "data")]) == 0
    dataset = MultiViewDataset(tmp_path / "data")
    np.testing.assert_array_equal(dataset.read("cameras/camera_from_world").reshape(-1, 4, 4)[:, 2, 3], 2.0)
