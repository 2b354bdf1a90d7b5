"""A process that hangs, is stopped or is left alone is ended; one that gets on is not."""

import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from nerf_rl.datasets.generation.watchdog import lookout
from nerf_rl.datasets.storage.shards import SHARDS

HANGS = """
import sys, time
from pathlib import Path
from nerf_rl.datasets.generation.watchdog import alarm

with alarm(Path(sys.argv[1]), timeout=float(sys.argv[2])) as beat:
    for _ in range(20):
        time.sleep(0.1)
        {beat}
print("got on")
"""
WORKER = """
import time
from nerf_rl.machine.processes import start_worker
start_worker()
print("ready", flush=True)
time.sleep(60)
"""
STARTS_A_WORKER = """
import subprocess, sys
started = subprocess.Popen([sys.executable, "-c", sys.argv[1]], stdout=subprocess.PIPE)
started.stdout.readline()
print(started.pid, flush=True)
"""


@pytest.fixture
def partial(tmp_path: Path) -> Path:
    """Where this test's process would write shard 3."""
    (tmp_path / SHARDS).mkdir()
    return tmp_path / SHARDS / ".000003.h5.1.partial"


def test_a_process_without_a_beat_ends_and_shows_where_it_hung(partial: Path):
    program = [sys.executable, "-c", HANGS.format(beat="time.sleep(60)"), str(partial), "0.5"]
    finished = subprocess.run(program, capture_output=True, text=True, timeout=60)
    assert finished.returncode == 1 and not finished.stdout
    assert "Timeout" in finished.stderr and 'File "<string>", line 9' in finished.stderr


def test_a_process_that_beats_gets_on_and_leaves_nothing(partial: Path):
    program = [sys.executable, "-c", HANGS.format(beat="beat()"), str(partial), "1.5"]
    finished = subprocess.run(program, capture_output=True, text=True, timeout=60)
    assert finished.stdout == "got on\n", finished.stderr
    assert not partial.exists()


def test_a_stopped_child_whose_shard_sees_no_beat_is_killed(partial: Path):
    child = subprocess.Popen(["sleep", "60"])
    child.send_signal(signal.SIGSTOP)
    partial.with_name(f".000003.h5.{child.pid}.partial").touch()
    with lookout(partial.parent.parent, [3], timeout=0.2):
        assert child.wait(30) == -signal.SIGKILL


def test_a_child_with_another_shard_or_with_beats_is_left_alone(partial: Path):
    other, beating = subprocess.Popen(["sleep", "60"]), subprocess.Popen(["sleep", "60"])
    partial.with_name(f".000004.h5.{other.pid}.partial").touch()
    beats = partial.with_name(f".000003.h5.{beating.pid}.partial")
    try:
        with lookout(partial.parent.parent, [3], timeout=1.2):
            for _ in range(20):
                beats.touch()
                time.sleep(0.1)
            assert other.poll() is None and beating.poll() is None
    finally:
        other.kill(), beating.kill()
        other.wait(), beating.wait()


def test_a_worker_ends_when_its_parent_has_gone():
    started = subprocess.run(
        [sys.executable, "-c", STARTS_A_WORKER, WORKER], stdout=subprocess.PIPE, text=True, timeout=60
    )
    status = Path(f"/proc/{int(started.stdout)}/stat")
    for _ in range(300):
        if not status.exists() or status.read_text().rpartition(")")[2].split()[0] == "Z":
            return
        time.sleep(0.1)
    raise AssertionError("the worker lives on without its parent")
