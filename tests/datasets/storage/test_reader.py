"""Reading shards: the same rows as h5py's, in any order, from any process."""

import gc
import inspect
import json
import os
import pickle
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
from torch.utils.data import DataLoader, Dataset

from nerf_rl.datasets.storage import reader
from nerf_rl.datasets.storage.reader import MultiViewDataset
from nerf_rl.datasets.storage.shards import MANIFEST, SCHEMA_VERSION, SHARDS, ShardWriter, frame_layout
from nerf_rl.errors import MissingFileError, UnknownNameError

VIEWS, SIZE = 3, 6
FRAMES = (3, 4, 2)  # of each shard; the first has as many as there are views
ARRAYS = ("rgb", "depth", "semantic", "episode", "reward", "state/qpos", "state/privileged", "state/mocap_pos")


def make_dataset(folder: Path, moving: bool) -> Path:
    """Write a dataset of random numbers."""
    rng = np.random.default_rng(0)
    sizes = {"nq": 3, "nv": 2, "nbody": 4, "nmocap": 0}
    layout = frame_layout(VIEWS, SIZE, moving, sizes, {"proprio": 4, "privileged": 9, "action": 4})
    poses = np.broadcast_to(np.eye(4), (VIEWS, 4, 4)) + rng.normal(size=(VIEWS, 4, 4))
    constant = {"cameras/intrinsics": rng.uniform(1, 2, (VIEWS, 3, 3))}
    if not moving:
        constant |= {
            "cameras/camera_from_world": poses,
            "cameras/projection": constant["cameras/intrinsics"] @ poses[:, :3],
        }
    (folder / SHARDS).mkdir(parents=True)
    entries = []
    for shard, frames in enumerate(FRAMES):
        path = folder / SHARDS / f"{shard:06d}.h5"
        with ShardWriter(path, frames, layout, constant) as writer:
            rows = {name: 100 * rng.random((frames, *shape)) for name, (shape, _) in layout.items()}
            writer.append({**rows, "split": np.arange(frames) % 2})
        entries.append({"file": f"{SHARDS}/{path.name}", "frames": frames, "sha256": f"{shard}"})
    manifest = {
        "schema_version": SCHEMA_VERSION,
        "shards": entries,
        "classes": [{"name": "background", "colour": [9, 9, 9]}, {"name": "drawer", "colour": [200, 0, 0]}],
        "cameras": [
            {"name": name, "role": role} for name, role in zip("abc", ("encoder", "test", "encoder"), strict=True)
        ],
        "columns": {"proprio": list("xyzg"), "privileged": list("abcdefghi"), "action": list("0123")},
    }
    (folder / MANIFEST).write_text(json.dumps(manifest))
    return folder


def by_h5py(folder: Path, name: str) -> np.ndarray:
    """Return all rows of an array."""
    parts = []
    for path in sorted((folder / SHARDS).iterdir()):
        with h5py.File(path) as file:
            parts.append(file[name][:])
    return np.concatenate(parts)


class Samples(Dataset):
    """Frames of a dataset for a DataLoader."""

    def __init__(self, dataset: MultiViewDataset):
        self.dataset = dataset

    def __len__(self) -> int:
        return len(self.dataset)

    def __getitem__(self, frame: int) -> dict[str, np.ndarray]:
        names = ("rgb", "depth", "state/qpos", "cameras/projection")
        return {name: self.dataset.read(name, [frame])[0] for name in names}


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    return make_dataset(tmp_path / "dataset", moving=False)


@pytest.mark.parametrize("name", ARRAYS)
def test_rows_are_h5pys_for_shuffled_and_repeated_frames(folder: Path, name: str):
    dataset, expected = MultiViewDataset(folder), by_h5py(folder, name)
    assert len(dataset) == len(expected) == sum(FRAMES)
    frames = np.concatenate([np.random.default_rng(1).permutation(len(dataset)), [4, 4, 0, 8, 0]])
    rows = dataset.read(name, frames)
    np.testing.assert_array_equal(rows, expected[frames])
    assert rows.dtype == expected.dtype
    np.testing.assert_array_equal(dataset.read(name), expected)
    np.testing.assert_array_equal(dataset.read(name, [7]), expected[[7]])


@pytest.mark.parametrize("moving", [False, True])
def test_matrices_come_for_each_frame_whether_cameras_move_or_not(tmp_path: Path, moving: bool):
    folder = make_dataset(tmp_path / "dataset", moving)
    dataset = MultiViewDataset(folder)
    frames = np.array([8, 2, 2, 5])
    for name in ("cameras/camera_from_world", "cameras/projection"):
        rows = dataset.read(name, frames)
        stored = by_h5py(folder, name)
        expected = stored[frames] if moving else np.broadcast_to(stored[:VIEWS], rows.shape)
        np.testing.assert_array_equal(rows, expected)
    intrinsics = by_h5py(folder, "cameras/intrinsics")[:VIEWS]
    np.testing.assert_array_equal(dataset.read("cameras/intrinsics", frames), np.stack([intrinsics] * 4))
    found, poses = dataset.cameras(frames)
    np.testing.assert_array_equal(found, intrinsics)
    np.testing.assert_array_equal(poses, dataset.read("cameras/camera_from_world", frames))
    np.testing.assert_allclose(dataset.projections(frames), intrinsics @ poses[:, :, :3])


def test_a_split_is_the_frames_that_say_so(folder: Path):
    dataset, split = MultiViewDataset(folder), by_h5py(folder, "split")
    np.testing.assert_array_equal(dataset.split("train"), np.flatnonzero(split == 0))
    np.testing.assert_array_equal(dataset.split("validation"), np.flatnonzero(split == 1))
    with pytest.raises(UnknownNameError, match=r"unknown split 'test'.*available: train, validation"):
        dataset.split("test")


def test_names_come_from_the_manifest(folder: Path):
    dataset = MultiViewDataset(folder)
    assert dataset.class_names == ("background", "drawer") and dataset.camera_names == ("a", "b", "c")
    assert dataset.views("encoder") == [0, 2] and dataset.views("test", "encoder") == [0, 1, 2]
    assert dataset.columns("proprio") == ("x", "y", "z", "g")
    np.testing.assert_array_equal(dataset.palette, np.array([[9, 9, 9], [200, 0, 0]], np.uint8))


def test_the_digest_changes_with_any_shard(folder: Path):
    before = MultiViewDataset(folder).digest()
    manifest = json.loads((folder / MANIFEST).read_text())
    assert MultiViewDataset(folder).digest() == before
    manifest["shards"][2]["sha256"] = "other"
    (folder / MANIFEST).write_text(json.dumps(manifest))
    assert MultiViewDataset(folder).digest() != before


def test_a_pickled_dataset_reads_the_same(folder: Path):
    dataset = MultiViewDataset(folder)
    expected = dataset.read("rgb")  # files are open now
    copy = pickle.loads(pickle.dumps(dataset))
    np.testing.assert_array_equal(copy.read("rgb"), expected)
    del copy
    np.testing.assert_array_equal(dataset.read("rgb"), expected)


@pytest.mark.parametrize("method", ["fork", "spawn", "forkserver"])
def test_a_dataloaders_workers_read_what_this_process_reads(folder: Path, method: str):
    dataset = MultiViewDataset(folder)
    samples = Samples(dataset)
    expected = [samples[frame] for frame in range(len(dataset))]  # files are open now
    count = 2 if method == "fork" else 1  # the others import torch anew
    loader = DataLoader(samples, batch_size=2, num_workers=count, multiprocessing_context=method)  # type: ignore[arg-type]
    batches = list(loader)
    for name in expected[0]:
        rows = np.concatenate([batch[name].numpy() for batch in batches])
        np.testing.assert_array_equal(rows, np.stack([sample[name] for sample in expected]))
    np.testing.assert_array_equal(dataset.read("depth"), by_h5py(folder, "depth"))


def test_threads_read_the_same_while_files_are_opened_and_closed(folder: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(reader, "_MOST_OPEN_FILES", 1)
    dataset, expected = MultiViewDataset(folder), by_h5py(folder, "rgb")

    def read(seed: int) -> bool:
        frames = np.random.default_rng(seed).permutation(len(expected))
        return all(np.array_equal(dataset.read("rgb", frames), expected[frames]) for _ in range(20))

    with ThreadPoolExecutor(4) as pool:
        assert all(pool.map(read, range(4)))


def test_no_more_files_stay_open_than_a_process_may_have(folder: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(reader, "_MOST_OPEN_FILES", 2)
    dataset = MultiViewDataset(folder)
    for frame in (0, 4, 8, 0):
        dataset.read("episode", [frame])
    gc.collect()
    targets = [os.readlink(link) for link in Path("/proc/self/fd").iterdir() if link.is_symlink()]
    assert sum(target.startswith(str(folder)) for target in targets) == 2


def test_neighbouring_frames_are_read_together(folder: Path, monkeypatch: pytest.MonkeyPatch):
    dataset, expected = MultiViewDataset(folder), by_h5py(folder, "depth")
    reads, read_rows = [], reader._read_rows
    monkeypatch.setattr(reader, "_read_rows", lambda *arguments: reads.append(arguments[-1]) or read_rows(*arguments))
    np.testing.assert_array_equal(dataset.read("depth", [1, 2, 3, 4, 5, 8, 0]), expected[[1, 2, 3, 4, 5, 8, 0]])
    assert reads == [2, 3, 1, 1]  # shards hold 3, 4 and 2 frames
    monkeypatch.setattr(reader, "_MOST_BYTES", 2 * expected[0].nbytes)
    np.testing.assert_array_equal(dataset.read("depth"), expected)
    assert reads[4:] == [2, 1, 2, 2, 2]


def test_a_shard_that_was_cut_off_is_an_error_not_noise(folder: Path):
    dataset = MultiViewDataset(folder)
    dataset.read("success", [0])
    with open(folder / SHARDS / "000000.h5", "r+b") as file:
        file.truncate(4096)
    with pytest.raises(OSError, match=r"000000\.h5 ends after"):
        dataset.read("depth", [0, 1, 2])


def test_an_unknown_array_is_answered_with_the_names(folder: Path):
    with pytest.raises(
        UnknownNameError, match=r"unknown array 'state/qpso'.*did you mean state/qpos.*available: .*rgb"
    ):
        MultiViewDataset(folder).read("state/qpso", [0])


def test_an_unknown_role_or_group_of_columns_is_answered_with_the_names(folder: Path):
    dataset = MultiViewDataset(folder)
    with pytest.raises(UnknownNameError, match=r"unknown role 'encodr' .*did you mean encoder"):
        dataset.views("test", "encodr")
    with pytest.raises(UnknownNameError, match=r"unknown group of columns 'propio' .*did you mean proprio"):
        dataset.columns("propio")


@pytest.mark.parametrize("frames", [[-1], [0, 9], []])
def test_frames_that_there_are_not_are_an_error(folder: Path, frames: list[int]):
    with pytest.raises(IndexError, match="some of 0 to 8"):
        MultiViewDataset(folder).read("rgb", frames)


@pytest.mark.parametrize("frames", [np.arange(9) > 5, [2.9], ["1"], np.array(1), [[0, 1]]])
def test_what_are_no_indices_of_frames_is_not_taken_for_some(folder: Path, frames: Any):
    read = inspect.unwrap(MultiViewDataset.read)  # as it is outside of tests, where nothing checks annotations
    with pytest.raises(IndexError, match=r"frames must be a list of whole numbers from 0 to 8, got .*flatnonzero"):
        read(MultiViewDataset(folder), "episode", frames)


def test_a_missing_shard_is_named(folder: Path):
    (folder / SHARDS / "000001.h5").unlink()
    with pytest.raises(MissingFileError, match=r"000001\.h5 is missing; make the dataset again with --resume true"):
        MultiViewDataset(folder)


def test_reading_opens_only_the_shards_it_needs(folder: Path):
    dataset = MultiViewDataset(folder)
    for shard in (0, 2):
        (folder / SHARDS / f"{shard:06d}.h5").write_bytes(b"")
    np.testing.assert_array_equal(dataset.read("episode", [4]).shape, (1,))
    with pytest.raises(OSError):
        dataset.read("episode", [0])
