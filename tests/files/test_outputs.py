"""Output folders: nothing of the user's is lost, and a file that exists is whole."""

import contextlib
import dataclasses
import json
import os
import platform
import shutil
from pathlib import Path
from typing import NoReturn

import pytest
import yaml

from nerf_rl.errors import OutputExistsError, UserError
from nerf_rl.files import folder_lock, outputs
from nerf_rl.files.atomic import atomic_write
from nerf_rl.files.versions import processor


@dataclasses.dataclass
class Inner:
    names: tuple[str, ...] = ("a", "b")


@dataclasses.dataclass
class Config:
    out: Path = Path("somewhere")
    seed: int = 7
    inner: Inner = dataclasses.field(default_factory=Inner)


@pytest.fixture
def foreign(tmp_path: Path) -> Path:
    """A folder with a file of the user's."""
    folder = tmp_path / "thesis"
    folder.mkdir()
    (folder / "chapter.tex").write_text("years of work")
    return folder


@pytest.fixture
def ours(tmp_path: Path) -> Path:
    """A folder that an earlier run wrote."""
    folder = tmp_path / "run"
    outputs.prepare_output(folder, overwrite=False)
    outputs.write_provenance(folder, "pretrain", Config())
    (folder / "old.txt").write_text("old")
    return folder


def test_a_new_output_folder_is_made_with_its_parents(tmp_path: Path):
    outputs.prepare_output(tmp_path / "a" / "b", overwrite=False)
    assert (tmp_path / "a" / "b").is_dir()


def test_an_empty_folder_is_accepted(tmp_path: Path):
    outputs.prepare_output(tmp_path, overwrite=False)
    assert list(tmp_path.iterdir()) == []


def test_a_full_folder_is_refused_and_kept(ours: Path):
    with pytest.raises(OutputExistsError, match="already exists and is not empty; use --overwrite true or another"):
        outputs.prepare_output(ours, overwrite=False)
    assert (ours / "old.txt").read_text() == "old"


@pytest.mark.parametrize("asked", [{"overwrite": False}, {"overwrite": True}, {"overwrite": False, "resume": True}])
def test_a_file_is_refused_as_one_and_kept(asked: dict[str, bool], tmp_path: Path):
    (tmp_path / "file").write_text("")
    for path in (tmp_path / "file", Path(os.devnull)):
        with pytest.raises(OutputExistsError, match=r"^output file .* already exists; a folder is what is written"):
            outputs.prepare_output(path, **asked)
    assert (tmp_path / "file").is_file()


def test_resuming_is_offered_only_where_it_is_possible(ours: Path, foreign: Path):
    with pytest.raises(OutputExistsError, match="--resume true"):
        outputs.prepare_output(ours, overwrite=False, can_resume=True)
    with pytest.raises(OutputExistsError, match=r"^((?!--resume).)*$"):
        outputs.prepare_output(foreign, overwrite=False, can_resume=True)


def test_resuming_keeps_what_is_there(ours: Path):
    outputs.prepare_output(ours, overwrite=False, resume=True, can_resume=True)
    assert (ours / "old.txt").read_text() == "old"


def test_overwriting_empties_a_folder_of_ours(ours: Path):
    outputs.prepare_output(ours, overwrite=True)
    assert list(ours.iterdir()) == []


def test_overwriting_never_removes_a_folder_that_is_not_ours(foreign: Path):
    with pytest.raises(OutputExistsError, match=r"holds no provenance\.json, so it is not overwritten"):
        outputs.prepare_output(foreign, overwrite=True)
    assert (foreign / "chapter.tex").read_text() == "years of work"


def test_an_output_that_is_a_file_is_refused_and_kept(foreign: Path):
    for overwrite in (False, True):
        with pytest.raises(OutputExistsError):
            outputs.prepare_output(foreign / "chapter.tex", overwrite=overwrite)
    assert (foreign / "chapter.tex").read_text() == "years of work"


@pytest.mark.parametrize("below", ["", "run"])
def test_an_output_that_is_or_lies_below_a_link_to_nothing_is_told_in_a_sentence(tmp_path: Path, below: str):
    (tmp_path / "link").symlink_to("nothing")
    for overwrite in (False, True):
        with pytest.raises(UserError, match=r"link is a link to nothing, which there is not; make it, or use another"):
            outputs.prepare_output(tmp_path / "link" / below, overwrite)
    (tmp_path / "nothing").mkdir()
    outputs.prepare_output(tmp_path / "link" / below, overwrite=False)
    assert (tmp_path / "nothing" / below).is_dir()


def test_a_write_that_fails_leaves_the_old_file_whole(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    path = tmp_path / "summary.json"
    outputs.write_text(path, "old")

    def fail(descriptor: int) -> None:
        raise OSError("no space left on device")

    monkeypatch.setattr(os, "fsync", fail)
    with pytest.raises(OSError, match="no space"):
        outputs.write_text(path, "new")
    assert path.read_text() == "old"


def test_a_written_file_replaces_the_old_one_and_leaves_nothing_beside(tmp_path: Path):
    outputs.write_text(tmp_path / "a.txt", "old")
    outputs.write_text(tmp_path / "a.txt", "nëw")
    assert [path.name for path in tmp_path.iterdir()] == ["a.txt"]
    assert (tmp_path / "a.txt").read_text(encoding="utf-8") == "nëw"


def test_a_folder_cut_off_while_it_was_overwritten_can_be_overwritten_again(
    ours: Path, monkeypatch: pytest.MonkeyPatch
):
    (ours / "zzz").mkdir()

    def stop(path: Path) -> None:
        raise KeyboardInterrupt

    with monkeypatch.context() as patch, pytest.raises(KeyboardInterrupt):
        patch.setattr(outputs.shutil, "rmtree", stop)
        outputs.prepare_output(ours, overwrite=True)
    assert (ours / "zzz").exists()
    outputs.prepare_output(ours, overwrite=True)
    assert list(ours.iterdir()) == []


def test_json_refuses_what_json_cannot_say(tmp_path: Path):
    with pytest.raises(ValueError, match="JSON compliant"):
        outputs.write_json(tmp_path / "a.json", {"psnr_db": float("inf")})
    assert not (tmp_path / "a.json").exists()


def test_provenance_records_config_seed_and_versions(ours: Path):
    assert yaml.safe_load((ours / "config.yaml").read_text()) == {
        "out": "somewhere",
        "seed": 7,
        "inner": {"names": ["a", "b"]},
    }
    provenance = json.loads((ours / "provenance.json").read_text())
    assert provenance["command"] == "pretrain"
    assert provenance["seed"] == 7
    assert {"torch", "mujoco", "numpy"} <= provenance["packages"].keys()
    assert provenance["processor"] == processor()


@pytest.mark.parametrize("tells_cores", [True, False])  # macOS does not tell which cores a process may use
def test_a_processor_has_a_name_and_its_instructions_for_bfloat16(
    tells_cores: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.setattr("os.cpu_count", lambda: 7)
    if tells_cores:
        monkeypatch.setattr("os.sched_getaffinity", lambda pid: {0, 5, 6})
    else:
        monkeypatch.delattr("os.sched_getaffinity")
    cores = 3 if tells_cores else 7
    cpuinfo = tmp_path / "cpuinfo"
    cpuinfo.write_text("model name\t: Some Processor\nflags\t\t: fpu avx512_bf16 sse\nmodel name\t: Some Processor\n")
    assert processor(cpuinfo) == f"Some Processor, {cores} cores (avx512_bf16)"
    cpuinfo.write_text("CPU implementer\t: 0x41\n")  # as Arm has it
    expected = f"{platform.machine()}, {cores} cores (without bfloat16)"
    assert processor(cpuinfo) == processor(tmp_path / "none") == expected


@pytest.mark.parametrize("content", ["", '{"command": ', "[]", '{"seed": 1}', '{"command": "tune"}'])
def test_a_folder_whose_provenance_is_damaged_or_anothers_is_not_resumed(content: str, tmp_path: Path):
    (tmp_path / outputs.PROVENANCE).write_text(content)
    with pytest.raises(OutputExistsError, match="already exists and is not empty; use --overwrite true or another"):
        outputs.prepare_output(tmp_path, overwrite=False, resume=True, command="pretrain")


@pytest.mark.parametrize("cut_at", ["write_json", "write_text"])
@pytest.mark.parametrize("asked", [{"overwrite": True}, {"overwrite": False, "resume": True}])
def test_a_folder_that_was_cut_off_in_its_first_files_is_begun_anew(
    cut_at: str, asked: dict[str, bool], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    def interrupted(*_: object) -> NoReturn:
        raise KeyboardInterrupt

    outputs.prepare_output(tmp_path, overwrite=False)
    with monkeypatch.context() as patch, pytest.raises(KeyboardInterrupt):
        patch.setattr(outputs, cut_at, interrupted)
        outputs.write_provenance(tmp_path, "pretrain", Config())
    outputs.prepare_output(tmp_path, **asked, command="pretrain")
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("asked", [{"overwrite": True}, {"overwrite": False, "resume": True}])
def test_what_a_killed_process_had_not_finished_writing_is_begun_anew_if_asked_for(
    asked: dict[str, bool], tmp_path: Path
):
    with contextlib.suppress(KeyboardInterrupt), atomic_write(tmp_path / "plan.json") as aside:
        shutil.copy(aside, tmp_path / "kept")
        raise KeyboardInterrupt
    (tmp_path / "kept").rename(aside)  # which a killed process does not remove
    with pytest.raises(OutputExistsError):
        outputs.prepare_output(tmp_path, overwrite=False)
    outputs.prepare_output(tmp_path, **asked)
    assert not list(tmp_path.iterdir())
    (tmp_path / "plan.json").write_text("{}")
    (tmp_path / aside.name).write_text("{")
    with pytest.raises(OutputExistsError):
        outputs.prepare_output(tmp_path, **asked)


def test_a_folder_that_the_system_does_not_let_be_made_is_told_in_a_sentence(foreign: Path):
    for folder in (Path("/proc/run"), foreign / "chapter.tex" / "run"):
        with pytest.raises(UserError, match=rf"{folder} cannot be written \(.+\); choose another name"):
            outputs.prepare_output(folder, overwrite=False)


def test_what_another_process_has_written_meanwhile_is_neither_emptied_nor_held(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    """Both look at a folder that is free; the second waits for the first, which ends soon."""
    out, hold = tmp_path / "out", outputs.hold_folder

    def hold_later(folder: Path) -> None:
        (folder / "summary.json").write_text("{}")
        hold(folder)

    monkeypatch.setattr(outputs, "hold_folder", hold_later)
    with pytest.raises(OutputExistsError, match="another process has just written it"):
        outputs.prepare_output(out, overwrite=False)
    assert (out / "summary.json").read_text() == "{}"
    about = out.stat()
    assert (about.st_dev, about.st_ino) not in folder_lock._held
