"""Shards are complete or absent, and manifests that cannot be read are told in words."""

import json
import os
from pathlib import Path

import h5py
import numpy as np
import pytest

from nerf_rl.datasets.storage.shards import (
    MANIFEST,
    PARTS,
    SCHEMA_VERSION,
    SHARDS,
    ShardWriter,
    frame_layout,
    read_manifest,
    sha256_of,
)
from nerf_rl.errors import MissingFileError
from nerf_rl.files.checksummed_json import write_checksummed

LAYOUT = {"rgb": ((2, 4, 4, 3), "u1"), "reward": ((), "<f4")}
CONSTANT = {"cameras/intrinsics": np.arange(18.0).reshape(2, 3, 3)}


def rows(first: int, count: int) -> dict[str, np.ndarray]:
    """Return frames whose numbers tell which they are."""
    numbers = np.arange(first, first + count)
    return {"rgb": np.broadcast_to(numbers[:, None, None, None, None], (count, 2, 4, 4, 3)), "reward": numbers / 2}


def write(path: Path, frames: int = 5) -> None:
    with ShardWriter(path, frames, LAYOUT, CONSTANT) as writer:
        for first in range(0, frames, 2):
            writer.append(rows(first, min(2, frames - first)))


def test_a_shard_holds_its_frames_in_order_and_its_constant_arrays(tmp_path: Path):
    write(tmp_path / "a.h5")
    with h5py.File(tmp_path / "a.h5") as file:
        np.testing.assert_array_equal(file["rgb"][:], rows(0, 5)["rgb"])
        np.testing.assert_array_equal(file["reward"][:], rows(0, 5)["reward"])
        np.testing.assert_array_equal(file["cameras/intrinsics"][:], CONSTANT["cameras/intrinsics"])
        assert file["rgb"].dtype == np.uint8 and file["reward"].dtype == np.float32
        assert file["rgb"].chunks is None and file["rgb"].compression is None
    assert [path.name for path in tmp_path.iterdir()] == ["a.h5"]


def test_writing_the_same_frames_again_gives_the_same_bytes(tmp_path: Path):
    write(tmp_path / "a.h5")
    write(tmp_path / "b.h5")
    assert (tmp_path / "a.h5").read_bytes() == (tmp_path / "b.h5").read_bytes()
    assert sha256_of(tmp_path / "a.h5") == sha256_of(tmp_path / "b.h5")


def test_a_shard_is_not_visible_before_it_is_whole(tmp_path: Path):
    path = tmp_path / "a.h5"
    with ShardWriter(path, 2, LAYOUT, CONSTANT) as writer:
        writer.append(rows(0, 1))
        assert not path.exists()
        writer.append(rows(1, 1))
        assert not path.exists()
        assert [other.suffix for other in tmp_path.iterdir()] == [".partial"]
    assert path.exists()


def test_too_few_frames_are_an_error_and_leave_nothing(tmp_path: Path):
    with (
        pytest.raises(RuntimeError, match=r"a\.h5: 3 frames were written instead of 5"),
        ShardWriter(tmp_path / "a.h5", 5, LAYOUT, CONSTANT) as writer,
    ):
        writer.append(rows(0, 3))
    assert not list(tmp_path.iterdir())


def test_too_many_frames_are_an_error_and_leave_nothing(tmp_path: Path):
    with pytest.raises((RuntimeError, TypeError, ValueError)), ShardWriter(tmp_path / "a.h5", 2, LAYOUT, {}) as writer:
        writer.append(rows(0, 3))
    assert not list(tmp_path.iterdir())


def test_an_error_while_writing_is_passed_on_and_leaves_nothing(tmp_path: Path):
    with pytest.raises(ZeroDivisionError), ShardWriter(tmp_path / "a.h5", 2, LAYOUT, CONSTANT) as writer:
        writer.append(rows(0, 2))
        raise ZeroDivisionError
    assert not list(tmp_path.iterdir())


def test_an_interrupted_rewrite_keeps_the_shard_that_was_there(tmp_path: Path):
    write(tmp_path / "a.h5")
    before = (tmp_path / "a.h5").read_bytes()
    with pytest.raises(KeyboardInterrupt), ShardWriter(tmp_path / "a.h5", 5, LAYOUT, CONSTANT) as writer:
        writer.append(rows(2, 2))
        raise KeyboardInterrupt
    assert (tmp_path / "a.h5").read_bytes() == before


def test_the_file_is_on_disk_before_it_gets_its_name_and_the_name_after(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    calls, fsync, replace = [], os.fsync, os.replace
    monkeypatch.setattr(os, "fsync", lambda descriptor: (calls.append("fsync"), fsync(descriptor)))
    monkeypatch.setattr(os, "replace", lambda *paths: (calls.append("replace"), replace(*paths)))
    write(tmp_path / "a.h5")
    assert calls == ["fsync", "replace", "fsync"]


def test_what_is_recorded_of_a_shard_is_in_the_file_and_keeps_it_reproducible(tmp_path: Path):
    for name in ("a.h5", "b.h5"):
        with ShardWriter(tmp_path / name, 2, LAYOUT, CONSTANT, {"plan": "abc"}) as writer:
            writer.append(rows(0, 2))
    assert (tmp_path / "a.h5").read_bytes() == (tmp_path / "b.h5").read_bytes()
    with h5py.File(tmp_path / "a.h5") as file:
        assert dict(file.attrs) == {"plan": "abc"}


def test_a_manifest_that_does_not_match_its_checksum_is_damaged(tmp_path: Path):
    write_checksummed(tmp_path / MANIFEST, {"schema_version": SCHEMA_VERSION, "frames": 30})
    assert read_manifest(tmp_path)["frames"] == 30
    text = (tmp_path / MANIFEST).read_text()
    (tmp_path / MANIFEST).write_text(text.replace("30", "31"))
    with pytest.raises(
        MissingFileError, match=r"manifest\.json is damaged; mend it with: nerf-rl check .* --repair true"
    ):
        read_manifest(tmp_path)


def test_a_folder_of_parts_is_to_be_merged(tmp_path: Path):
    (tmp_path / PARTS).mkdir()
    with pytest.raises(MissingFileError, match="it holds parts of one; put them together with: nerf-rl merge"):
        read_manifest(tmp_path)


def test_extrinsics_have_a_row_a_frame_only_if_cameras_move():
    sizes = {"nq": 3, "nv": 2, "nbody": 4, "nmocap": 1}
    columns = {"proprio": 4, "privileged": 9, "action": 4}
    fixed, moving = (frame_layout(2, 8, cameras_move, sizes, columns) for cameras_move in (False, True))
    assert set(moving) - set(fixed) == {"cameras/camera_from_world", "cameras/projection"}
    assert moving["cameras/projection"][0] == (2, 3, 4) and moving["cameras/camera_from_world"][0] == (2, 4, 4)
    assert fixed["rgb"] == ((2, 8, 8, 3), "u1") and fixed["state/privileged"] == ((9,), "<f4")


def test_a_folder_that_does_not_exist_is_no_dataset(tmp_path: Path):
    with pytest.raises(
        MissingFileError, match="is not a dataset: the folder does not exist; make one with: nerf-rl gen-"
    ):
        read_manifest(tmp_path / "nothing")


def test_a_folder_without_a_manifest_is_no_dataset(tmp_path: Path):
    with pytest.raises(MissingFileError, match=r"is not a dataset: it holds no manifest\.json; make one with"):
        read_manifest(tmp_path)


def test_an_unfinished_dataset_can_be_resumed(tmp_path: Path):
    (tmp_path / SHARDS).mkdir()
    with pytest.raises(MissingFileError, match="it is not finished; finish it with the same command and --resume true"):
        read_manifest(tmp_path)


@pytest.mark.parametrize("content", ["{", "[]", '{"frames": 3}', "7", "\x00\xff"])
def test_a_damaged_manifest_is_told_as_such(tmp_path: Path, content: str):
    (tmp_path / MANIFEST).write_text(content, encoding="latin-1")
    with pytest.raises(MissingFileError, match=r"manifest\.json is damaged"):
        read_manifest(tmp_path)


def test_another_schema_is_told_with_its_version(tmp_path: Path):
    (tmp_path / MANIFEST).write_text(json.dumps({"schema_version": SCHEMA_VERSION + 1}))
    with pytest.raises(MissingFileError, match=f"its schema version is {SCHEMA_VERSION + 1}"):
        read_manifest(tmp_path)
