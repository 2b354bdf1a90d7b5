"""Generations that are killed, interrupted, or run out of disk, as the command line runs them."""

import os
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from nerf_rl import cli
from nerf_rl.datasets.generation.unfinished import OutputRecord
from nerf_rl.datasets.storage.shards import MANIFEST, SHARDS, partial_files
from nerf_rl.errors import OutputExistsError

SMALL_DISK = ["unshare", "--user", "--map-root-user", "--mount", "sh", "-c"]
FILLS_THE_DISK = """
import sys
from pathlib import Path
import numpy as np
from nerf_rl.datasets.storage.disk import explain_full_disk
from nerf_rl.datasets.storage.shards import ShardWriter
from nerf_rl.errors import FailureError

folder = Path(sys.argv[1])
try:
    with explain_full_disk(folder, lambda: 12_345_678):
        for number in range(3):
            with ShardWriter(folder / f"{number}.h5", 1, {"rgb": ((100_000,), "u1")}, {}) as writer:
                writer.append({"rgb": np.ones((1, 100_000), np.uint8)})
except FailureError as error:
    print(error, sorted(path.name for path in folder.iterdir()))
"""


def start(recipe: Path, out: Path, *arguments: str) -> subprocess.Popen:
    """Start a generation in a session of its own, as a terminal would."""
    program = [sys.executable, "-m", "nerf_rl.cli", "gen-dataset", "--config", str(recipe), "--out", str(out)]
    return subprocess.Popen([*program, *arguments], start_new_session=True, stderr=subprocess.PIPE, text=True)


def wait_for_a_worker(folder: Path, process: subprocess.Popen) -> int:
    """Wait until a worker has begun a shard; return its process id."""
    for _ in range(1200):
        begun = partial_files(folder, range(10))
        if begun:
            return next(iter(begun.values()))[1]
        assert process.poll() is None
        time.sleep(0.05)
    raise AssertionError("no worker began")


def ends(pid: int) -> bool:
    """Wait until a process has ended."""
    for _ in range(600):
        status = Path(f"/proc/{pid}/stat")
        if not status.exists() or status.read_text().rpartition(")")[2].split()[0] == "Z":
            return True
        time.sleep(0.05)
    return False


def content(folder: Path) -> dict[str, bytes]:
    paths = [*(folder / SHARDS).iterdir(), folder / MANIFEST, folder / "plan.json"]
    return {path.name: path.read_bytes() for path in paths}


def test_killed_then_interrupted_a_generation_leaves_no_process_and_resumes_to_the_same_bytes(
    tiny_recipe: Path, tmp_path: Path
):
    long = ["--episodes", "60", "--episodes_per_shard", "20"]  # so that it is not over before it is killed
    command = ["gen-dataset", "--config", str(tiny_recipe), *long]
    folder, undisturbed = tmp_path / "data", tmp_path / "undisturbed"
    process = start(tiny_recipe, folder, *long)
    worker = wait_for_a_worker(folder, process)
    process.kill()  # its workers are left alone
    process.communicate()
    assert ends(worker)
    assert not (folder / MANIFEST).exists()

    for path in partial_files(folder, range(10)):
        path.unlink()
    process = start(tiny_recipe, folder, *long, "--resume", "true")
    worker = wait_for_a_worker(folder, process)
    os.killpg(process.pid, signal.SIGINT)  # what Ctrl-C does
    _, shown = process.communicate(timeout=60)
    assert process.returncode == 130 and shown.startswith("nerf-rl gen-dataset: interrupted\n")
    # importing glfw starts a process that complains when its parent, a worker that has just begun, is ended meanwhile
    assert shown.count("nerf-rl") == 1 and "KeyboardInterrupt" not in shown
    assert ends(worker)
    assert partial_files(folder, range(10)) == {}

    assert cli.main([*command, "--out", str(folder), "--resume", "true"]) == 0
    assert cli.main([*command, "--out", str(undisturbed)]) == 0
    assert content(folder) == content(undisturbed)


def test_a_finished_dataset_has_nothing_to_resume(
    tiny_dataset: Path, tiny_recipe: Path, capsys: pytest.CaptureFixture[str]
):
    before = {path: path.stat().st_mtime_ns for path in tiny_dataset.rglob("*")}
    assert cli.main(["gen-dataset", "--config", str(tiny_recipe), "--out", str(tiny_dataset), "--resume", "true"]) == 0
    assert "nothing to do, all 2 shards are there" in capsys.readouterr().out
    assert {path: path.stat().st_mtime_ns for path in tiny_dataset.rglob("*")} == before


def test_a_folder_killed_before_its_plan_was_written_can_be_resumed(tiny_recipe: Path, tmp_path: Path):
    (tmp_path / ".partial-plan.json").write_text("{")
    arguments = ["--config", str(tiny_recipe), "--out", str(tmp_path)]
    with pytest.raises(OutputExistsError, match="not empty; use "):
        OutputRecord(cli.parse("gen-dataset", arguments)).check()
    OutputRecord(cli.parse("gen-dataset", [*arguments, "--resume", "true"])).check()


def test_too_little_disk_is_told_before_any_work(tiny_recipe: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    huge = ["--episodes", str(10**10), "--episodes_per_shard", str(10**10)]
    assert cli.main(["gen-dataset", "--config", str(tiny_recipe), "--out", str(tmp_path / "out"), *huge]) == 1
    message = capsys.readouterr().err
    assert " TB and its disk has " in message and message.count("\n") == 1
    assert list(tmp_path.iterdir()) == []


def test_a_disk_that_becomes_full_is_told_with_what_is_needed_and_keeps_what_is_whole(tmp_path: Path):
    if shutil.which("unshare") is None or subprocess.run([*SMALL_DISK, "true"], capture_output=True).returncode:
        pytest.skip("no user namespaces to mount a small disk in")
    script = f'mount -t tmpfs -o size=256k tmpfs {tmp_path} && exec {sys.executable} -c "$PROGRAM" {tmp_path}'
    finished = subprocess.run(
        [*SMALL_DISK, script], env={**os.environ, "PROGRAM": FILLS_THE_DISK}, capture_output=True, text=True
    )
    assert f"the disk of {tmp_path} is full: 12.3 MB are still to be written and " in finished.stdout, finished.stderr
    assert "with --resume true ['0.h5', '1.h5']" in finished.stdout
