"""The server whose forks worker processes are: it imports beside the process that begins it, and hears no Ctrl-C."""

import os
import subprocess
import sys
from pathlib import Path

SLOW = """
import time
from pathlib import Path
Path("begun").touch()
time.sleep(1.0)
"""
PROGRAM = """
import multiprocessing, os, signal, sys, time
from pathlib import Path
from nerf_rl.machine.processes import start_method, start_server

def look(told):
    told.put(("slow_module" in sys.modules, time.monotonic()))

if __name__ == "__main__":
    start_server(["slow_module"])
    returned = time.monotonic()
    while not Path("begun").exists():
        time.sleep(0.01)
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # this process lives on; the server has the handler it was born with
    os.killpg(0, signal.SIGINT)
    context = multiprocessing.get_context(start_method(["another_module"]))
    told = context.SimpleQueue()
    process = context.Process(target=look, args=(told,))
    process.start()
    imported, when = told.get()
    process.join()
    print(imported, when > returned + 0.5)
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
    assert (done.stdout, done.stderr) == ("True True\n", "")
