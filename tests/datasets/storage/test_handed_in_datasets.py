"""Datasets that somebody repacked, edited or damaged: one sentence, never noise and never a file elsewhere."""

import json
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest

from nerf_rl import cli
from nerf_rl.datasets.storage.frames import read_frame
from nerf_rl.datasets.storage.reader import MultiViewDataset
from nerf_rl.datasets.storage.shards import MANIFEST, SHARDS
from nerf_rl.errors import UserError
from nerf_rl.files.checksummed_json import with_checksum
from nerf_rl.files.json_files import json_text
from nerf_rl.pretrain.model.encoder_rig import EncoderRig

SECOND = f"{SHARDS}/000001.h5"
Repack = Callable[[h5py.File], None]


@pytest.fixture
def folder(tiny_dataset: Path, tmp_path: Path) -> Path:
    """A copy of the tiny dataset, to damage."""
    return Path(shutil.copytree(tiny_dataset, tmp_path / "data"))


def replace(name: str, **options: Any) -> Repack:
    """Return what writes an array of a shard again, otherwise."""

    def change(file: h5py.File) -> None:
        values = file[name][:]
        del file[name]
        file.create_dataset(name, **{"data": values, **options})

    return change


def link(target: Any) -> Repack:
    def change(file: h5py.File) -> None:
        file.move("rgb", "other")
        file["rgb"] = target

    return change


def external(file: h5py.File) -> None:
    shape, dtype = file["rgb"].shape, file["rgb"].dtype
    del file["rgb"]
    file.create_dataset("rgb", shape, dtype, external=[("/etc/passwd", 0, h5py.h5f.UNLIMITED)])


@pytest.mark.parametrize(
    "repack, fault",
    [
        (replace("rgb", compression="gzip"), "rgb is not contiguous but in chunks, compressed or virtual; undo that"),
        (replace("depth", chunks=True), "depth is not contiguous but in chunks"),
        (replace("depth", dtype=">f4"), "depth holds >f4 instead of <f4"),
        (replace("state/qpos", dtype="<f4"), "state/qpos holds <f4 instead of <f8"),
        (replace("rgb", data=np.zeros((6, 4, 9, 9, 3), "u1")), "rgb has the shape 6x4x9x9x3 instead of 6x4x24x24x3"),
        (replace("reward", data=np.zeros(5, np.float32)), "reward has the shape 5 instead of 6"),
        (replace("episode", data="text"), "episode holds |O instead of <i4"),
        (link(h5py.SoftLink("/other")), "rgb is a link to somewhere else"),
        (link(h5py.ExternalLink("000000.h5", "rgb")), "rgb is a link to somewhere else"),
        (external, "rgb lies in another file"),
    ],
)  # fmt: skip
def test_a_shard_that_was_written_again_otherwise_is_refused_by_name(folder: Path, repack: Repack, fault: str):
    with h5py.File(folder / SECOND, "r+") as file:
        repack(file)
    dataset = MultiViewDataset(folder)
    dataset.read("rgb", [0])
    with pytest.raises(UserError) as refusal:
        dataset.read("rgb", [7])
    assert f"{SECOND} is not a readable shard: {fault}" in str(refusal.value)


def test_a_repacked_shard_is_one_sentence_of_the_command(folder: Path, capsys: pytest.CaptureFixture[str]):
    for shard in (folder / SHARDS).iterdir():
        with h5py.File(shard, "r+") as file:
            replace("rgb", compression="gzip")(file)
    assert cli.main(["view", str(folder), "--save", str(folder / "page.html")]) == 2
    message = capsys.readouterr().err
    assert "000000.h5 is not a readable shard: rgb is not contiguous" in message and message.count("\n") == 1


@pytest.mark.parametrize("share", [0.3, 0.6, 0.9999])
def test_a_shard_that_was_cut_short_is_refused(folder: Path, share: float):
    path = folder / SECOND
    with open(path, "r+b") as file:
        file.truncate(int(share * path.stat().st_size))
    with pytest.raises(UserError, match=r"too short for the 6 frames|000001\.h5 is not a readable shard"):
        MultiViewDataset(folder).read("rgb", [7])


def edit(change: Callable[[dict], Any]) -> Callable[[dict], dict]:
    def edited(manifest: dict) -> dict:
        change(manifest)
        return manifest

    return edited


EDITS = [
    (edit(lambda m: m["shards"][0].update(file="../..")), "shards.0.file is '../..' instead of the name of a shard"),
    (edit(lambda m: m["shards"][0].update(file="/etc/passwd")), "shards.0.file is '/etc/passwd' instead of"),
    (edit(lambda m: m["shards"][0].update(file="shards/../../x/shards/000000.h5")), "shards.0.file is "),
    (edit(lambda m: m["shards"][0].update(file="shards/000000.h5\n")), "shards.0.file is "),
    (edit(lambda m: m["shards"][1].update(frames=-1)), "shards.1.frames is -1 instead of a whole number from 1"),
    (edit(lambda m: m["shards"][1].update(frames=True)), "shards.1.frames is True instead of a whole number"),
    (edit(lambda m: m["shards"][1].update(frames=6.0)), "shards.1.frames is 6.0 instead of a whole number"),
    (edit(lambda m: m.update(cameras={})), "cameras is a mapping instead of a list"),
    (edit(lambda m: m["cameras"][2].update(role="spy")), "cameras.2.role is 'spy' instead of one of encoder"),
    (edit(lambda m: m["classes"][0].update(colour=[0, 0, 256])), "classes.0.colour.2 is 256 instead of"),
    (edit(lambda m: m["columns"].pop("action")), "columns is a mapping instead of one with action, which is missing"),
    (edit(lambda m: m.update(height=10**9)), "height is 1000000000 instead of a whole number from 1 to 16384"),
    (lambda m: [m], "the whole is a list of 1 instead of a mapping"),
]


@pytest.mark.parametrize("change, fault", EDITS)
def test_a_manifest_of_another_structure_is_refused_even_if_signed(folder: Path, change: Callable, fault: str):
    manifest = change(json.loads((folder / MANIFEST).read_text()))
    (folder / MANIFEST).write_text(json_text(with_checksum(manifest) if isinstance(manifest, dict) else manifest))
    with pytest.raises(UserError) as refusal:
        MultiViewDataset(folder)
    assert f"({fault}" in str(refusal.value) and "manifest.json is damaged" in str(refusal.value)


def test_more_frames_than_a_shard_can_hold_are_not_believed(folder: Path):
    manifest = json.loads((folder / MANIFEST).read_text())
    manifest["shards"][1]["frames"] = 10**9
    (folder / MANIFEST).write_text(json_text(with_checksum(manifest)))
    with pytest.raises(UserError, match=r"000001\.h5 is too short for the 1000000000 frames that the manifest counts"):
        MultiViewDataset(folder)


def test_what_a_manifest_does_not_say_is_told_when_it_is_needed(folder: Path):
    manifest = json.loads((folder / MANIFEST).read_text())
    del manifest["scene"], manifest["checksum"]
    (folder / MANIFEST).write_text(json_text(manifest))
    with pytest.raises(UserError, match=r"manifest\.json is not a whole manifest: it does not say scene; mend it"):
        MultiViewDataset(folder).manifest["scene"]


@pytest.mark.parametrize(
    "content", [b"", b"\xff\xfe", b"[" * 100_000, b'{"schema_version": NaN}', b"9" * 5000, b"null"]
)
def test_what_is_no_json_is_a_damaged_manifest(folder: Path, content: bytes):
    (folder / MANIFEST).write_bytes(content)
    with pytest.raises(UserError, match=r"manifest\.json is damaged; mend it with"):
        MultiViewDataset(folder)


def test_a_shard_may_lie_elsewhere_if_the_owner_of_the_folder_links_it(folder: Path, tmp_path: Path):
    expected = MultiViewDataset(folder).read("rgb")
    (folder / SECOND).rename(tmp_path / "blob")
    (folder / SECOND).symlink_to(tmp_path / "blob")
    np.testing.assert_array_equal(MultiViewDataset(folder).read("rgb"), expected)


@pytest.mark.parametrize(
    "name, value, read, fault",
    [
        (
            "semantic",
            200,
            lambda dataset: dataset.read_labels(),
            "a picture shows the class 200, but its manifest names",
        ),
        ("semantic", 200, lambda dataset: read_frame(dataset, 7), "a picture shows the class 200"),
        ("split", 9, lambda dataset: dataset.split("train"), "a frame's split is 9"),
        ("split", 9, lambda dataset: read_frame(dataset, 7), "a frame's split is 9"),
        ("cameras/intrinsics", np.nan, EncoderRig.of_dataset, "a camera's matrices are not finite"),
        ("cameras/camera_from_world", np.inf, EncoderRig.of_dataset, "a camera's matrices are not finite"),
    ],
)
def test_values_that_mean_nothing_are_told(folder: Path, name: str, value: float, read: Callable, fault: str):
    for shard in (folder / SHARDS).iterdir():
        with h5py.File(shard, "r+") as file:
            file[name][...] = value
    with pytest.raises(UserError, match="data is damaged: ") as refusal:
        read(MultiViewDataset(folder))
    assert fault in str(refusal.value)
