"""The server whose forks worker processes are: it imports beside the process that begins it, and hears no Ctrl-C."""

import multiprocessing
import os
import subprocess
import sys
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
