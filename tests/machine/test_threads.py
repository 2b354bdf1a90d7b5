"""Threads of PyTorch that wait asleep leave their cores to others."""

import subprocess
import sys
from pathlib import Path

import pytest

PROGRAM = """
import sys
from nerf_rl import cli
from nerf_rl.machine import threads

def told() -> None:
    sys.exit("too late" if "torch" in sys.modules else 0)

threads.wait_passively = told
cli.main(sys.argv[1:])
sys.exit("never")
"""


@pytest.mark.parametrize(
    "command",
    [
        ["pretrain", "--data", "DATASET", "--out", "OUT"],
        ["probe", "--data", "DATASET", "--encoder", "ENCODER"],
        ["view", "ENCODER", "--save", "OUT.html"],
        ["report", "--agent", "AGENT", "--out", "OUT.html"],
    ],
    ids=lambda command: command[0],
)
def test_commands_that_compute_with_threads_ask_for_it_before_pytorch_is_loaded(
    command: list[str], tiny_dataset: Path, tiny_encoder: Path, tiny_agent: Path, tmp_path: Path
) -> None:
    places = {"DATASET": tiny_dataset, "ENCODER": tiny_encoder, "AGENT": tiny_agent, "OUT": tmp_path / "out"}
    for name, place in places.items():
        command = [word.replace(name, str(place)) for word in command]
    subprocess.run([sys.executable, "-c", PROGRAM, *command], check=True)
