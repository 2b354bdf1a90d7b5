"""The server whose forks worker processes are: it imports beside the process that begins it, and hears no Ctrl-C."""

import contextlib
import multiprocessing
import os
import signal
import subprocess
import sys
import textwrap
import time
from collections.abc import Callable
from multiprocessing import forkserver
from pathlib import Path

import pytest

from nerf_rl.machine.processes import start_server

SLOW = """
import time
from pathlib import Path
Path("begun").touch()
while not Path("go").exists():
    time.sleep(0.01)
"""
PROGRAM = """
import multiprocessing, os, signal, sys, time
from pathlib import Path
from nerf_rl.machine.processes import start_method, start_server

def look(told):
    told.put("slow_module" in sys.modules)

if __name__ == "__main__":
    start_server(["slow_module"])
    while not Path("begun").exists():
        time.sleep(0.01)
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # this process lives on; the server has the handler it was born with
    os.killpg(0, signal.SIGINT)
    Path("go").touch()  # had the server's imports been waited for, nobody would have come here
    context = multiprocessing.get_context(start_method(["another_module"]))
    told = context.SimpleQueue()
    process = context.Process(target=look, args=(told,))
    process.start()
    print(told.get())
    process.join()
"""


def test_a_server_imports_meanwhile_whatever_is_asked_for_later_and_lives_through_ctrl_c(tmp_path: Path) -> None:
    (tmp_path / "slow_module.py").write_text(SLOW)
    (tmp_path / "program.py").write_text(PROGRAM)
    modules = os.pathsep.join([str(tmp_path), *filter(None, sys.path)])
    done = subprocess.run(
        [sys.executable, "program.py"],
        cwd=tmp_path,
        env={**os.environ, "PYTHONPATH": modules},
        capture_output=True,
        text=True,
        timeout=60,
        start_new_session=True,
    )
    assert (done.stdout, done.stderr) == ("True\n", "")


def test_where_the_system_has_no_such_server_none_is_begun(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(multiprocessing, "get_all_start_methods", lambda: ["spawn"])  # of Windows
    monkeypatch.setattr(forkserver, "ensure_running", lambda: pytest.fail("a server was begun"))
    start_server(["nerf_rl.errors"])


def wait_until(holds: Callable[[], bool]) -> None:
    for _ in range(6000):
        if holds():
            return
        time.sleep(0.01)
    raise AssertionError("that has not come about in a minute")


def running_in_group(group: int) -> list[str]:
    """Return the processes of a group, by number, that have not ended."""
    found = []
    for status in Path("/proc").glob("[0-9]*/stat"):
        with contextlib.suppress(FileNotFoundError, ProcessLookupError):
            state, _, of_group = status.read_text().rpartition(")")[2].split()[:3]
            found += [status.parent.name] if state != "Z" and int(of_group) == group else []
    return found


STARTS = {
    "a pool": """
    from nerf_rl.machine.worker_pools import LocalProcesses
    list(LocalProcesses([]).as_they_end([functools.partial(work)] * 2, 2))
""",
    "a sweep": """
    from nerf_rl.rl.config import TrainRLConfig
    from nerf_rl.rl.sweeps.workers import train_seeds_apart
    list(train_seeds_apart(work, TrainRLConfig("", "out", workers=2), [0, 1]))
""",
    "a search": """
    from nerf_rl.tuning.supervisor import supervise
    from test_tuning_study import start_study
    supervise(start_study(Path("."), 12, hang=range(12)), workers=2)
""",
    "devices": """
    from nerf_rl.pretrain.config import PretrainConfig
    from nerf_rl.pretrain.execution.launch import run_on_each_device
    run_on_each_device(PretrainConfig("data", "out", devices=2), work)
""",
}
STARTING = """
import functools, time
from multiprocessing import forkserver
from pathlib import Path
from nerf_rl.machine import processes
from nerf_rl.machine.termination import Termination

def work(*arguments):
    time.sleep(3600)

def connect(descriptors):
    Path("starting").touch()
    return connect_to_new_process(descriptors)

if __name__ == "__main__":
    connect_to_new_process, forkserver.connect_to_new_process = forkserver.connect_to_new_process, connect
    processes.start_server(["slow_module"])
    with Termination():
        {start}
"""


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM], ids=["Ctrl-C", "SIGTERM"])
@pytest.mark.parametrize("start", STARTS.values(), ids=STARTS)
def test_an_interruption_while_processes_start_is_neither_lost_nor_leaves_any(
    start: str, number: signal.Signals, tmp_path: Path
) -> None:
    (tmp_path / "slow_module.py").write_text(SLOW)
    (tmp_path / "program.py").write_text(STARTING.format(start=textwrap.indent(start, "    ").strip()))
    paths = [tmp_path, Path("tests/tuning").resolve(), *filter(None, sys.path)]
    program = subprocess.Popen(
        [sys.executable, "program.py"],
        cwd=tmp_path,
        env={**os.environ, "PYTHONPATH": os.pathsep.join(map(str, paths))},
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )
    try:
        wait_until(lambda: program.poll() is not None or (tmp_path / "starting").exists())
        wait_until((tmp_path / "begun").exists)
        if number == signal.SIGINT:
            os.killpg(program.pid, number)  # as a terminal does
        else:
            os.kill(program.pid, number)
        (tmp_path / "go").touch()
        assert program.communicate(timeout=60)[1].rstrip().endswith("KeyboardInterrupt")
        wait_until(lambda: not running_in_group(program.pid))
    finally:
        with contextlib.suppress(ProcessLookupError):
            os.killpg(program.pid, signal.SIGKILL)
