"""SIGTERM: as Ctrl-C, with a sentence and an exit code of its own."""

import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from types import FrameType

import pytest
from tiny_recipes import TINY_TRAINING

from nerf_rl import cli
from nerf_rl.machine.termination import Termination

FORK = """
import os, signal, time
from nerf_rl.machine.termination import Termination
with Termination():
    child = os.fork()
    if child == 0:
        try:
            time.sleep(60)
        finally:
            os._exit(7)
    time.sleep(0.5)
    os.kill(child, signal.SIGTERM)
    print(os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]))
"""


def test_it_interrupts_once_and_is_what_it_was_afterwards():
    with Termination() as termination:
        with pytest.raises(KeyboardInterrupt):
            signal.raise_signal(signal.SIGTERM)
        assert termination.asked and signal.getsignal(signal.SIGTERM) is signal.SIG_DFL
    with Termination() as termination:
        assert signal.getsignal(signal.SIGTERM) is not signal.SIG_DFL
    assert not termination.asked and signal.getsignal(signal.SIGTERM) is signal.SIG_DFL


@pytest.mark.parametrize("handler", [signal.SIG_IGN, lambda number, frame: None])
def test_somebody_elses_handler_stays(handler: signal.Handlers | Callable, monkeypatch: pytest.MonkeyPatch):
    signal.signal(signal.SIGTERM, handler)
    try:
        with Termination() as termination:
            signal.raise_signal(signal.SIGTERM)
            assert signal.getsignal(signal.SIGTERM) is handler and not termination.asked
        assert signal.getsignal(signal.SIGTERM) is handler
    finally:
        signal.signal(signal.SIGTERM, signal.SIG_DFL)


def test_who_handles_it_later_and_calls_ours_too_decides_what_happens():
    called = []
    with Termination() as termination:
        ours = signal.getsignal(signal.SIGTERM)
        assert callable(ours)

        def theirs(number: int, frame: FrameType | None) -> None:
            called.append(number)
            ours(number, frame)

        signal.signal(signal.SIGTERM, theirs)
        signal.raise_signal(signal.SIGTERM)
        assert termination.asked and called == [signal.SIGTERM] and signal.getsignal(signal.SIGTERM) is theirs


def test_a_fork_ends_at_once_whatever_it_would_catch():
    finished = subprocess.run([sys.executable, "-c", FORK], capture_output=True, text=True, check=True)
    assert finished.stdout.strip() == str(-signal.SIGTERM)


@pytest.mark.parametrize("command", ["train-rl", "pretrain"])
def test_a_command_ends_with_a_sentence_and_goes_on_from_its_checkpoint(
    command: str, tiny_dataset: Path, tiny_pretraining_recipe: Path, tmp_path: Path
):
    out = tmp_path / "out"
    words = {
        "train-rl": [*TINY_TRAINING, "--env_steps", "100000", "--checkpoint_every", "40"],
        "pretrain": ["--config", str(tiny_pretraining_recipe), "--data", str(tiny_dataset), "--steps", "100000"],
    }[command]
    program = [sys.executable, "-m", "nerf_rl", command, *words, "--out", str(out)]
    process = subprocess.Popen(program, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True)
    while not any((out / "checkpoints").glob("*")):
        assert process.poll() is None
        time.sleep(0.1)
    os.kill(process.pid, signal.SIGTERM)
    _, said = process.communicate(timeout=120)
    assert process.returncode == 143
    assert said.splitlines()[-1] == f"nerf-rl {command}: terminated" and "Traceback" not in said
    sooner = [*words, "--env_steps", "80"] if command == "train-rl" else [*words, "--steps", "2"]
    assert cli.main([command, *sooner, "--out", str(out), "--resume", "true"]) == 0
    assert (out / "summary.json").is_file()
