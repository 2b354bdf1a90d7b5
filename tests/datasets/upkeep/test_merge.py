"""Parts rendered by several jobs, put together, are the dataset of one run."""

import shutil
from pathlib import Path

import pytest

from nerf_rl import cli
from nerf_rl.datasets.storage.shards import MANIFEST, PARTS, SHARDS
from nerf_rl.files.checksummed_json import write_checksummed
from nerf_rl.files.json_files import read_json


def render(recipe: Path, out: Path, shard: str, *arguments: str) -> int:
    """Render a part."""
    return cli.main(["gen-dataset", "--config", str(recipe), "--out", str(out), "--shard", shard, *arguments])


def content(folder: Path) -> dict[str, bytes]:
    """Return the files that must not depend on how a dataset was made."""
    paths = [*(folder / SHARDS).iterdir(), folder / MANIFEST, folder / "plan.json"]
    return {path.name: path.read_bytes() for path in paths}


@pytest.fixture(scope="module")
def parts(tiny_recipe: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder that two jobs have rendered to; tests leave it as it is."""
    folder = tmp_path_factory.mktemp("parts") / "data"
    assert render(tiny_recipe, folder, "2/2") == render(tiny_recipe, folder, "1/2") == 0
    return folder


@pytest.fixture
def apart(parts: Path, tmp_path: Path) -> tuple[Path, Path]:
    """The same, each part in a folder of its own."""
    folders = tmp_path / "first", tmp_path / "second"
    for number, folder in enumerate(folders):
        shutil.copytree(parts, folder)
        (folder / SHARDS / f"{1 - number:06d}.h5").unlink()
        shutil.rmtree(folder / PARTS / f"{2 - number}-of-2")
    return folders


def test_parts_in_one_folder_become_the_dataset_of_one_run(parts: Path, tiny_dataset: Path, tmp_path: Path):
    folder = Path(shutil.copytree(parts, tmp_path / "data"))
    assert cli.main(["merge", str(folder)]) == 0
    assert content(folder) == content(tiny_dataset)
    assert cli.main(["check", str(folder)]) == 0
    one, other = (read_json(path / "summary.json") for path in (folder, tiny_dataset))
    assert one.keys() == other.keys() and one["views"] == other["views"]


def test_parts_from_several_folders_are_copied_and_kept(apart: tuple[Path, Path], tiny_dataset: Path, tmp_path: Path):
    before = [path.read_bytes() for folder in apart for path in folder.rglob("*") if path.is_file()]
    assert cli.main(["merge", *map(str, apart), "--out", str(tmp_path / "all")]) == 0
    assert content(tmp_path / "all") == content(tiny_dataset)
    assert [path.read_bytes() for folder in apart for path in folder.rglob("*") if path.is_file()] == before


def test_renderers_are_each_named_once_whatever_their_parts_name(
    apart: tuple[Path, Path], tiny_dataset: Path, tmp_path: Path
):
    """A part that got no shard names none, and a part that was made by several names them together."""
    first, second = (next((folder / PARTS).iterdir()) for folder in apart)
    manifest = read_json(first / MANIFEST)
    own = manifest["renderer"]
    shutil.copytree(first, first.parent / "3-of-3")
    write_checksummed(first.parent / "3-of-3" / MANIFEST, {**manifest, "renderer": "", "frames": 0, "shards": []})
    command = ["merge", *map(str, apart), "--overwrite", "true", "--out", str(tmp_path / "all")]
    assert cli.main(command) == 0
    assert content(tmp_path / "all") == content(tiny_dataset)
    write_checksummed(second / MANIFEST, {**read_json(second / MANIFEST), "renderer": f"another card and {own}"})
    assert cli.main(command) == 0
    assert read_json(tmp_path / "all" / MANIFEST)["renderer"] == " and ".join(sorted(["another card", own]))


def test_an_interrupted_merge_goes_on(apart: tuple[Path, Path], tiny_dataset: Path, tmp_path: Path):
    out = tmp_path / "all"
    arguments = ["merge", *map(str, apart), "--out", str(out)]
    assert cli.main(arguments) == 0
    (out / MANIFEST).unlink()
    (out / SHARDS / "000001.h5").write_bytes(b"half")
    kept = (out / SHARDS / "000000.h5").stat().st_mtime_ns
    assert cli.main(arguments) == 2
    assert cli.main([*arguments, "--resume", "true"]) == 0
    assert content(out) == content(tiny_dataset)
    assert (out / SHARDS / "000000.h5").stat().st_mtime_ns == kept


def test_a_damaged_shard_costs_a_merged_dataset_no_more_than_that_shard(
    parts: Path, tiny_dataset: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
):
    folder = Path(shutil.copytree(parts, tmp_path / "data"))
    assert cli.main(["merge", str(folder)]) == 0
    (folder / SHARDS / "000001.h5").write_bytes(b"changed")
    assert cli.main(["merge", str(folder)]) == 1
    assert "000001.h5 is not what its part recorded" in capsys.readouterr().err
    assert (folder / MANIFEST).read_bytes() == (tiny_dataset / MANIFEST).read_bytes()


def test_what_parts_measured_is_not_needed_and_no_folder_counts_twice(
    parts: Path, tiny_dataset: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
):
    folder = Path(shutil.copytree(parts, tmp_path / "data"))
    first, second = sorted(folder.glob(f"{PARTS}/*/summary.json"))
    seconds = read_json(second)["seconds"]
    first.write_text("{}")
    again = folder.parent / "." / ".." / folder.parent.name / folder.name
    assert cli.main(["merge", str(folder), str(again), "--out", str(tmp_path / "all")]) == 0
    assert content(tmp_path / "all") == content(tiny_dataset)
    assert read_json(tmp_path / "all" / "summary.json")["seconds"] == seconds
    assert "12 frames, 48 views of 2 parts" in capsys.readouterr().out
    second.write_text('{"seconds"')
    assert cli.main(["merge", str(folder)]) == 0
    assert content(folder) == content(tiny_dataset)


def test_parts_of_several_folders_count_once_each(parts: Path, tiny_dataset: Path, tmp_path: Path):
    for name, other in (("first", "2-of-2"), ("second", "1-of-2")):
        shutil.copytree(parts, tmp_path / name, ignore=shutil.ignore_patterns(other))
    first, second = str(tmp_path / "first"), str(tmp_path / "second")
    assert cli.main(["merge", first, second, "--out", first]) == 0  # which holds both parts then
    seconds = read_json(tmp_path / "first" / "summary.json")["seconds"]
    assert cli.main(["merge", first, second, "--out", str(tmp_path / "all")]) == 0
    assert read_json(tmp_path / "all" / "summary.json")["seconds"] == seconds
    assert content(tmp_path / "all") == content(tiny_dataset)


def test_commands_in_sentences_can_be_pasted(
    parts: Path, tiny_dataset: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
):
    folder, damaged = tmp_path / "my parts", tmp_path / "my data"
    shutil.copytree(parts, folder)
    shutil.copytree(tiny_dataset, damaged)
    (damaged / SHARDS / "000001.h5").write_bytes(b"changed")
    for words, command in (
        (["check", str(folder)], f"nerf-rl merge '{folder}'"),
        (["view", str(folder)], f"nerf-rl merge '{folder}'"),
        (["check", str(damaged)], f"nerf-rl check '{damaged}' --repair true"),
    ):
        assert cli.main(words) in (1, 2)
        assert command in capsys.readouterr().err


def test_a_part_refuses_a_folder_of_another_plan_and_its_own_twice(
    parts: Path, tiny_dataset: Path, tiny_recipe: Path, capsys: pytest.CaptureFixture[str]
):
    before = {path: path.stat().st_mtime_ns for path in parts.rglob("*")}
    assert render(tiny_recipe, parts, "1/3", "--seed", "9") == 2
    assert "was begun with another configuration" in capsys.readouterr().err
    assert render(tiny_recipe, parts, "1/2") == 2
    assert "1-of-2 already exists and is not empty; use --resume true" in capsys.readouterr().err
    assert render(tiny_recipe, tiny_dataset, "1/2") == 2
    assert "it holds no parts that this one could join" in capsys.readouterr().err
    assert {path: path.stat().st_mtime_ns for path in parts.rglob("*")} == before


@pytest.mark.parametrize("shard", ["0/2", "3/2", "2", "1/0", "a/b", "1/2/3"])
def test_a_share_that_there_is_not_is_refused(shard: str, capsys: pytest.CaptureFixture[str]):
    assert cli.main(["gen-dataset", "--out", "x", "--shard", shard]) == 2
    assert f"--shard must be I/N with I from 1 to N, such as 2/8, got '{shard}'" in capsys.readouterr().err


def test_what_is_missing_unfinished_damaged_or_of_another_dataset_is_told(
    apart: tuple[Path, Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
):
    def message_of(*arguments: str) -> str:
        assert cli.main(["merge", *arguments]) in (1, 2)
        assert not (tmp_path / "all" / MANIFEST).exists()
        shown = capsys.readouterr().err
        assert shown.count("\n") == 1
        return shown

    first, second = apart
    both = [str(first), str(second), "--out", str(tmp_path / "all")]
    assert "--out is needed to put 2 folders together" in message_of(*both[:2])
    assert "--parts is empty; name the folders" in message_of("--parts", "[]", "--out", str(tmp_path / "all"))
    assert "1 of 2 shards are in no part, such as 000001" in message_of(str(first))
    assert "is not a folder with parts of a dataset" in message_of(str(tmp_path))

    (second / SHARDS / "000001.h5").write_bytes(b"changed")
    assert "000001.h5 is not what its part recorded" in message_of(*both)
    record = second / PARTS / "2-of-2"
    manifest = read_json(record / MANIFEST)
    manifest["packages"]["mujoco"] = "2.0"
    write_checksummed(record / MANIFEST, manifest)
    assert "different datasets; they differ in packages: {'mujoco': '3." in message_of(*both, "--resume", "true")
    (record / MANIFEST).write_text((record / MANIFEST).read_text().replace("2.0", "2.1"))
    assert "is damaged; write it again with gen-dataset --shard 2/2 --resume true" in message_of(*both)
    (record / MANIFEST).unlink()
    assert "part 2/2 in " in message_of(*both)
