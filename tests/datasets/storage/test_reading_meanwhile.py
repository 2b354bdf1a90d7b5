"""Reading a dataset that is still being written."""

import shutil
from pathlib import Path

import numpy as np
import pytest

from nerf_rl import cli
from nerf_rl.datasets.generation.generator import generate_dataset
from nerf_rl.datasets.storage.reader import MultiViewDataset
from nerf_rl.datasets.storage.shards import MANIFEST, UNFINISHED, shard_path
from nerf_rl.errors import MissingFileError, UserError
from nerf_rl.viewer.subject import Subject, find_subject


@pytest.fixture(scope="module")
def cut_off(tiny_dataset: Path, tiny_recipe: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A dataset whose second and last shard was not written."""
    folder = tmp_path_factory.mktemp("cut off") / "data"
    config = cli.parse("gen-dataset", ["--config", str(tiny_recipe), "--out", str(folder)])
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("nerf_rl.datasets.generation.generator.with_shards", stop)
        with pytest.raises(KeyboardInterrupt):
            generate_dataset(config)
    shard_path(folder, 1).unlink()
    return folder


def stop(*_: object) -> None:
    raise KeyboardInterrupt


def test_the_whole_shards_of_an_unfinished_dataset_can_be_read(cut_off: Path, tiny_dataset: Path):
    so_far, whole = MultiViewDataset(cut_off, unfinished=True), MultiViewDataset(tiny_dataset)
    assert not so_far.is_finished and whole.is_finished
    assert len(so_far) == 6 and so_far.class_names == whole.class_names
    for name in ("rgb", "semantic", "state/qpos", "episode"):
        np.testing.assert_array_equal(so_far.read(name), whole.read(name, np.arange(6)))
    with pytest.raises(UserError, match="is not finished, so nothing identifies its content yet"):
        so_far.digest()
    assert find_subject(cut_off) is Subject.DATASET


def test_without_asking_for_it_an_unfinished_dataset_is_refused(cut_off: Path):
    with pytest.raises(MissingFileError, match="it is not finished; finish it with the same command and --resume true"):
        MultiViewDataset(cut_off)


def test_a_dataset_without_a_whole_shard_is_told_to_wait_for_one(cut_off: Path, tmp_path: Path):
    shutil.copytree(cut_off, tmp_path / "data")
    shard_path(tmp_path / "data", 0).unlink()
    with pytest.raises(MissingFileError, match="it has no whole shard yet; wait for the first one"):
        MultiViewDataset(tmp_path / "data", unfinished=True)


def test_a_finished_dataset_is_the_same_either_way_and_keeps_no_mark(tiny_dataset: Path):
    assert MultiViewDataset(tiny_dataset, unfinished=True).digest() == MultiViewDataset(tiny_dataset).digest()
    assert not (tiny_dataset / UNFINISHED).exists()


def test_a_cut_off_dataset_is_finished_as_if_nothing_had_been(cut_off: Path, tiny_dataset: Path, tiny_recipe: Path):
    assert cli.main(["gen-dataset", "--config", str(tiny_recipe), "--out", str(cut_off), "--resume", "true"]) == 0
    assert (cut_off / MANIFEST).read_bytes() == (tiny_dataset / MANIFEST).read_bytes()
    assert not (cut_off / UNFINISHED).exists()
