"""What servers of forks import: a GPU's runtime, once it is asked for its devices, survives no fork."""

import subprocess
import sys

import pytest

from nerf_rl.rl.environments.make import EnvSpec, _worker_modules
from nerf_rl.rl.sweeps.workers import training_modules

IMPORTS = """
import importlib, sys, threading
import torch

def refuse(*arguments):
    raise AssertionError("a GPU is asked for")

for name in ("device_count", "is_available", "init"):
    setattr(torch.cuda, name, refuse)
for module in sys.argv[1:]:
    importlib.import_module(module)
assert threading.active_count() == 1, threading.enumerate()
"""


@pytest.mark.parametrize(("device", "expected"), [("cpu", True), ("cuda", False), ("cuda:1", False), ("auto", False)])
def test_processes_that_may_learn_on_a_gpu_import_what_they_learn_with_themselves(device: str, expected: bool):
    assert bool(training_modules(device)) == expected


def test_what_servers_import_for_processes_with_a_gpu_asks_for_none_and_starts_no_thread():
    eyes = _worker_modules(EnvSpec("metaworld/drawer-open-v3", "runs/encoder", 1, 200))
    modules = [*eyes, "nerf_rl.pretrain.fitting", "nerf_rl.tuning.objective", "nerf_rl.tuning.worker"]
    done = subprocess.run([sys.executable, "-c", IMPORTS, *modules], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
