"""Checking a dataset finds any damage and names it; repairing brings back the very bytes."""

import errno
import shutil
from collections.abc import Callable
from pathlib import Path

import h5py
import numpy as np
import pytest

from nerf_rl import cli
from nerf_rl.datasets.generation.unfinished import OutputRecord
from nerf_rl.datasets.storage.shards import MANIFEST, SHARDS, read_manifest, sha256_of
from nerf_rl.datasets.upkeep import repair
from nerf_rl.files.checksummed_json import write_checksummed
from nerf_rl.files.json_files import read_json

FIRST, SECOND = f"{SHARDS}/000000.h5", f"{SHARDS}/000001.h5"
Checked = Callable[..., tuple[int, str, str]]


@pytest.fixture
def folder(tiny_dataset: Path, tmp_path: Path) -> Path:
    """A copy of the tiny dataset, to damage."""
    return Path(shutil.copytree(tiny_dataset, tmp_path / "data"))


@pytest.fixture
def check(folder: Path, capsys: pytest.CaptureFixture[str]) -> Checked:
    """Run ``nerf-rl check``; returns its exit code, output and message."""

    def run(*arguments: str) -> tuple[int, str, str]:
        capsys.readouterr()
        code = cli.main(["check", str(folder), *arguments])
        return code, *capsys.readouterr()

    return run


def flip(path: Path, place: int) -> None:
    content = bytearray(path.read_bytes())
    content[place] ^= 0x10
    path.write_bytes(content)


def change_and_sign(folder: Path, change: Callable[[h5py.File], None]) -> None:
    """Change a shard's content and sign it in the manifest, as if it had been made so."""
    with h5py.File(folder / SECOND, "r+") as file:
        change(file)
    manifest = read_manifest(folder)
    manifest["shards"][1]["sha256"] = sha256_of(folder / SECOND)
    write_checksummed(folder / MANIFEST, manifest)


def test_a_whole_dataset_is_told_as_such_and_left_alone(folder: Path, tiny_dataset: Path, check: Checked):
    code, shown, message = check()
    assert code == 0 and shown.endswith("whole and unchanged\n") and not message
    assert (folder / MANIFEST).read_bytes() == (tiny_dataset / MANIFEST).read_bytes()


@pytest.mark.parametrize("file", [FIRST, SECOND, MANIFEST, "plan.json"])
def test_a_changed_byte_anywhere_is_found_in_its_file(folder: Path, check: Checked, file: str):
    size = (folder / file).stat().st_size
    rng = np.random.default_rng(1)
    for place in (0, size - 1, *rng.integers(0, size, 6).tolist()):
        flip(folder / file, place)
        code, shown, message = check()
        flip(folder / file, place)
        assert code == 1 and f"is damaged: {file}; nerf-rl check {folder} --repair true" in message
        assert f"{folder / file}: " in shown
    assert check()[0] == 0


def test_missing_and_foreign_shards_are_named(folder: Path, check: Checked):
    (folder / FIRST).unlink()
    (folder / SHARDS / "000007.h5").write_bytes(b"")
    code, shown, message = check()
    assert code == 1 and f"is damaged: {SHARDS}/000007.h5, {FIRST}; " in message
    assert f"{FIRST}: it is missing" in shown and "000007.h5: manifest.json does not name it" in shown


@pytest.mark.parametrize(
    "change, fault",
    [
        (lambda file: file["rgb"].__setitem__((4, 2), 0), "camera right sees nothing: its picture is black"),
        (lambda file: file["depth"].__setitem__((4, 0, 3, 3), np.nan), "camera top has a depth that is not finite"),
        (lambda file: file["state/qpos"].__setitem__((4, 1), np.inf), "state/qpos is not finite"),
        (lambda file: file["semantic"].__setitem__((4, 1, 1, 1), 200), "it has semantic classes beyond the "),
    ],
)
def test_frames_that_show_nothing_are_found_even_if_signed(
    folder: Path, check: Checked, change: Callable[[h5py.File], None], fault: str
):
    change_and_sign(folder, change)
    code, shown, message = check()
    assert code == 1 and f"is damaged: {SECOND}; " in message
    assert fault in shown


def test_a_frame_is_named_by_episode_and_step(folder: Path, check: Checked):
    change_and_sign(folder, lambda file: file["rgb"].__setitem__((4, 2), 0))
    with h5py.File(folder / SECOND) as file:
        name = f"episode {file['episode'][4]}, step {file['step'][4]}: camera right"
    assert name in check()[1]


def test_a_wrong_number_of_frames_is_found(folder: Path, check: Checked):
    manifest = read_manifest(folder)
    manifest["shards"][0]["frames"] += 1
    write_checksummed(folder / MANIFEST, manifest)
    _, shown, message = check()
    assert f"is damaged: {MANIFEST}, {FIRST}; " in message
    assert "it has 6 frames instead of 7" in shown and "it counts other than 12 frames" in shown


def test_repairing_brings_the_same_bytes_back_and_says_what_it_cannot_mend(
    folder: Path, tiny_dataset: Path, check: Checked
):
    flip(folder / SECOND, 5000)
    (folder / "plan.json").unlink()
    foreign = folder / SHARDS / "notes.txt"
    foreign.write_text("mine")
    kept = (folder / FIRST).stat().st_mtime_ns
    code, _, message = check("--repair", "true", "--workers", "1")
    assert code == 1 and f"what is wrong with {SHARDS}/notes.txt cannot be repaired" in message
    assert foreign.read_text() == "mine"
    foreign.unlink()
    for file in (FIRST, SECOND, MANIFEST, "plan.json"):
        assert (folder / file).read_bytes() == (tiny_dataset / file).read_bytes()
    assert (folder / FIRST).stat().st_mtime_ns == kept
    assert {path.name for path in folder.iterdir()} == {path.name for path in tiny_dataset.iterdir()}


@pytest.mark.parametrize("whole", [True, False])
def test_shards_come_back_though_their_folder_is_gone(folder: Path, tiny_dataset: Path, check: Checked, whole: bool):
    shutil.rmtree(folder / SHARDS)
    if not whole:
        flip(folder / MANIFEST, 100)
    assert check("--repair", "true", "--workers", "1")[0] == 0
    for file in (FIRST, SECOND, MANIFEST):
        assert (folder / file).read_bytes() == (tiny_dataset / file).read_bytes()


def test_what_has_the_name_of_a_shard_or_of_their_folder_is_told_before_anything_is_rendered(
    folder: Path, check: Checked, monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.setattr(repair, "render_shards", None)
    (folder / SECOND).unlink()
    (folder / SECOND).mkdir()
    code, shown, message = check("--repair", "true")
    assert code == 2 and f"{SECOND}: it is a folder" in shown and f"{SECOND} is a folder, and a shard" in message
    shutil.rmtree(folder / SHARDS)
    (folder / SHARDS).write_text("")
    code, _, message = check("--repair", "true")
    assert code == 2 and f"{SHARDS} is no folder, and shards belong there; move it away" in message


@pytest.mark.parametrize("step", ["write_json", "_render", "rename_durably"])
def test_a_disk_that_becomes_full_in_a_repair_is_told_in_a_sentence(
    folder: Path, check: Checked, monkeypatch: pytest.MonkeyPatch, step: str
):
    def full(*_: object):
        raise OSError(errno.ENOSPC, "No space left on device")

    (folder / SECOND).unlink()
    monkeypatch.setattr(repair, step, full)
    code, _, message = check("--repair", "true", "--workers", "1")
    assert code == 1 and f"the disk of {folder} is full: " in message.splitlines()[-1]
    assert message.endswith("free some space and run the same command again\n")


def test_a_shard_that_comes_out_otherwise_is_left_as_it_was(folder: Path, check: Checked):
    manifest = read_manifest(folder)
    manifest["renderer"], manifest["shards"][1]["sha256"] = "another card", "0" * 64
    write_checksummed(folder / MANIFEST, manifest)
    before = (folder / SECOND).read_bytes()
    code, _, message = check("--repair", "true", "--workers", "1")
    assert code == 1 and f"{SECOND} came out otherwise than recorded and was left as it was: here " in message
    assert "it was made by another card" in message and message.count("\n") == 1
    assert (folder / SECOND).read_bytes() == before


def test_a_damaged_manifest_is_written_again_from_plan_and_shards(folder: Path, tiny_dataset: Path, check: Checked):
    text = (folder / MANIFEST).read_text()
    (folder / MANIFEST).write_text(text.replace('"drawer"', '"drewar"'))
    code, shown, message = check("--repair", "true")
    assert code == 0 and "repaired manifest.json" in shown and not message
    assert (folder / MANIFEST).read_bytes() == (tiny_dataset / MANIFEST).read_bytes()


def test_when_nothing_tells_what_the_dataset_was_that_is_said(folder: Path, check: Checked):
    flip(folder / MANIFEST, 100)
    (folder / "plan.json").write_text("{")
    code, _, message = check("--repair", "true")
    assert code == 2 and "manifest.json and plan.json are both damaged; make the dataset again" in message


def test_what_is_no_dataset_is_not_checked(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    assert cli.main(["check", str(tmp_path / "nothing")]) == 2
    assert "is not a dataset: the folder does not exist" in capsys.readouterr().err


def test_resuming_does_not_sign_a_damaged_shard(folder: Path, tiny_recipe: Path):
    arguments = ["--config", str(tiny_recipe), "--out", str(folder), "--resume", "true"]
    record = OutputRecord(cli.parse("gen-dataset", arguments))
    scene = read_json(folder / MANIFEST)["scene"]
    assert list(record.finished_shards(scene)) == [0, 1]
    with h5py.File(folder / SECOND, "r+") as file:
        file["reward"][0] += 1
    assert list(record.finished_shards(scene)) == [0]
    record.begin([0], {})
    assert not (folder / SECOND).exists() and not (folder / MANIFEST).exists()


def test_what_was_made_from_a_path_is_repaired_where_the_path_begins(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
):
    (tmp_path / "scene.xml").write_text(
        "<mujoco><worldbody><light pos='0 0 2'/><geom type='plane' size='2 2 0.1'/>"
        "<body pos='0 0 0.1'><freejoint/><geom size='0.1' rgba='1 0 0 1'/></body></worldbody></mujoco>"
    )
    monkeypatch.chdir(tmp_path)
    size = ["--episodes", "1", "--frames_per_episode", "2", "--episode_steps", "2", "--size", "16", "--workers", "1"]
    words = ["--scene", "scene.xml", "--behaviour.random", "1", "--validation_fraction", "0", *size]
    assert cli.main(["gen-dataset", *words, "--out", "data"]) == 0
    whole = (tmp_path / "data" / FIRST).read_bytes()
    flip(tmp_path / "data" / FIRST, 3000)
    (tmp_path / "elsewhere").mkdir()
    monkeypatch.chdir(tmp_path / "elsewhere")
    capsys.readouterr()
    assert cli.main(["check", "../data", "--repair", "true"]) == 2
    said = capsys.readouterr().err.splitlines()[-1]
    assert said.startswith(
        "nerf-rl check: ../data cannot be rendered anew here: scene.xml is not an MJCF file: no such"
    )
    assert said.endswith("run the command in the folder in which gen-dataset ran, where its paths begin")
    monkeypatch.chdir(tmp_path)
    assert cli.main(["check", "data", "--repair", "true"]) == 0
    assert (tmp_path / "data" / FIRST).read_bytes() == whole
