"""Two processes never write to one output folder."""

import errno
import fcntl
import os
import shutil
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from nerf_rl import cli
from nerf_rl.files import folder_lock
from nerf_rl.files.folder_lock import hold_folder, release_folders

HOLDER = """
import pathlib, sys
from nerf_rl.files.folder_lock import hold_folder
hold_folder(pathlib.Path(sys.argv[1]))
print("held", flush=True)
sys.stdin.read()
"""


@pytest.fixture
def holder(tiny_dataset: Path, tmp_path: Path) -> Iterator[tuple[subprocess.Popen, Path]]:
    """Another process that holds a folder in which a dataset was begun."""
    folder = shutil.copytree(tiny_dataset, tmp_path / "data")
    (folder / "summary.json").unlink()
    process = subprocess.Popen(
        [sys.executable, "-c", HOLDER, str(folder)], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    )
    assert process.stdout is not None and process.stdout.readline() == "held\n"
    yield process, folder
    process.kill()
    process.communicate()


@pytest.mark.parametrize("how", ["--resume", "--overwrite"])
def test_a_folder_that_is_being_written_to_is_left_alone_until_its_writer_is_killed(
    how: str,
    holder: tuple[subprocess.Popen, Path],
    tiny_recipe: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    process, folder = holder
    monkeypatch.setattr(folder_lock, "_PATIENCE", 0.2)
    before = {path: path.stat().st_mtime_ns for path in folder.rglob("*")}
    command = ["gen-dataset", "--config", str(tiny_recipe), "--out", str(folder), how, "true"]
    assert cli.main(command) == 2
    assert f"another process is writing to {folder}; wait until it has ended, or use another --out" in (
        capsys.readouterr().err
    )
    assert {path: path.stat().st_mtime_ns for path in folder.rglob("*")} == before
    process.kill()
    process.wait()
    assert cli.main(command) == 0


def test_what_a_killed_process_has_forked_is_waited_for(tmp_path: Path) -> None:
    program = "import os, pathlib, sys, time; from nerf_rl.files.folder_lock import hold_folder;"
    program += "hold_folder(pathlib.Path(sys.argv[1])); os.fork() or time.sleep(1)"
    subprocess.run([sys.executable, "-c", program, str(tmp_path)], check=True)  # its child is there for a second yet
    hold_folder(tmp_path)
    release_folders()


def test_a_process_may_hold_a_folder_again_and_lets_go_of_all(tmp_path: Path) -> None:
    hold_folder(tmp_path)
    hold_folder(tmp_path)
    release_folders()
    other = os.open(tmp_path, os.O_RDONLY)
    fcntl.flock(other, fcntl.LOCK_EX | fcntl.LOCK_NB)
    os.close(other)


def test_a_file_system_without_locks_has_none(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def none(*_: Any) -> None:
        raise OSError(errno.ENOLCK, "No locks available")

    monkeypatch.setattr(fcntl, "flock", none)
    hold_folder(tmp_path)
    monkeypatch.undo()
    hold_folder(tmp_path)
    release_folders()
