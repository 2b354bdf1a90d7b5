"""Several processes that share a run: the same training as one, one result, and what happens when one of them goes."""

import csv
import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
import torch

from nerf_rl import cli
from nerf_rl.errors import UserError
from nerf_rl.pretrain.config import PretrainConfig
from nerf_rl.pretrain.execution.launch import rank_from_outside, run_on_each_device
from nerf_rl.pretrain.execution.placement import choose_accelerator, thread_count

STEPS = 20
SHARED = ["--steps", str(STEPS), "--steps_per_epoch", "8", "--scenes_per_step", "4", "--validation_frames", "3"]
SHARED += ["--log_every", "1", "--accelerator", "cpu"]
TWO = ["--devices", "2"]
TIMEOUT = 240.0

Arguments = Callable[..., list[str]]


@pytest.fixture(scope="module")
def arguments(tiny_pretraining_recipe: Path, tiny_dataset: Path) -> Arguments:
    """Return the words of a command that trains for 20 steps of 4 scenes."""

    def make(out: Path, *more: str) -> list[str]:
        folders = ["--config", str(tiny_pretraining_recipe), "--data", str(tiny_dataset), "--out", str(out)]
        return ["pretrain", *folders, *SHARED, *more]

    return make


@pytest.fixture(scope="module")
def alone(arguments: Arguments, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The run folder of one process."""
    out = tmp_path_factory.mktemp("devices") / "alone"
    assert cli.main(arguments(out)) == 0
    return out


@pytest.fixture(scope="module")
def together(arguments: Arguments, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The run folder of two processes, which was killed with one of them after the first epoch, and resumed."""
    out = tmp_path_factory.mktemp("devices") / "together"
    command = [sys.executable, "-m", "nerf_rl", *arguments(out, *TWO)]
    run = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True)
    wait_until(lambda: (out / "checkpoints" / "last.ckpt").is_file() or run.poll() is not None)
    os.kill(ranks_of(run.pid)[1], signal.SIGKILL)
    _, errors = run.communicate(timeout=TIMEOUT)
    (out / "after_the_kill.json").write_text(json.dumps({"code": run.returncode, "errors": errors}))
    assert cli.main(arguments(out, *TWO, "--resume", "true")) == 0
    return out


def wait_until(condition: Callable[[], bool]) -> None:
    end = time.monotonic() + TIMEOUT
    while not condition():
        assert time.monotonic() < end
        time.sleep(0.02)


def ranks_of(command: int) -> list[int]:
    """Return the processes that share a command's run, by rank: forks of the server that it has started."""
    return sorted(fork for server in children_of(command) for fork in children_of(server))


def children_of(parent: int) -> list[int]:
    found = []
    for folder in Path("/proc").glob("[0-9]*"):
        try:
            state = (folder / "stat").read_text()
        except OSError:  # gone meanwhile
            continue
        if int(state.rpartition(")")[2].split()[1]) == parent:
            found.append(int(folder.name))
    return found


def logged(run: Path, column: str) -> dict[int, float]:
    """Return a column of a run's logs by step, those of its resumptions included."""
    values = {}
    for path in sorted(run.glob("logs/**/metrics.csv")):
        with open(path) as file:
            values |= {int(row["step"]): float(row[column]) for row in csv.DictReader(file) if row.get(column)}
    return values


def test_two_processes_have_the_losses_of_one_with_the_same_batches(alone: Path, together: Path):
    for loss in ("total", "rgb", "semantic", "depth", "feature"):
        expected, found = logged(alone, f"train/{loss}"), logged(together, f"train/{loss}")
        assert len(expected) == STEPS
        assert {step: pytest.approx(value, abs=1e-5) for step, value in expected.items()} == found


def test_two_processes_write_one_result_that_is_the_result_of_one(alone: Path, together: Path):
    mine, theirs = (json.loads((run / "summary.json").read_text()) for run in (alone, together))
    assert (mine["processes"], theirs["processes"]) == (1, 2) and theirs["device"] == "cpu"
    assert theirs["validation"] == pytest.approx(mine["validation"], rel=1e-4)
    names = {path.name for path in together.iterdir()} - {"after_the_kill.json"}
    assert names == {path.name for path in alone.iterdir()}


def test_a_killed_process_ends_the_run_with_a_sentence(together: Path):
    result = json.loads((together / "after_the_kill.json").read_text())
    assert result["code"] == 1
    assert result["errors"].strip().splitlines()[-1] == (
        "nerf-rl pretrain: process 1 of 2 was ended by SIGKILL, and the others cannot go on without it; "
        "go on from the last checkpoint with --resume true"
    )
    assert "Traceback" not in result["errors"]


def test_torchrun_can_start_the_processes(arguments: Arguments, alone: Path, tmp_path: Path):
    out = tmp_path / "run"
    starter = [sys.executable, "-m", "torch.distributed.run", "--standalone", "--nproc-per-node", "2"]
    done = subprocess.run(
        [*starter, "-m", "nerf_rl.cli", *arguments(out, *TWO)], capture_output=True, text=True, timeout=TIMEOUT
    )
    assert done.returncode == 0, done.stderr
    assert done.stdout.count("writing to") == 1 and done.stdout.count("linear probe") == 1
    expected, found = logged(alone, "train/total"), logged(out, "train/total")
    assert {step: pytest.approx(value, abs=1e-5) for step, value in expected.items()} == found


@pytest.fixture
def slurm_job(monkeypatch: pytest.MonkeyPatch) -> Iterator[pytest.MonkeyPatch]:
    """The variables of the third of four tasks of a SLURM job."""
    job = {"JOB_ID": "7", "JOB_NAME": "train", "NTASKS": "4", "PROCID": "2", "LOCALID": "2", "NODEID": "0"}
    for name, value in {**job, "NODELIST": "node1", "JOB_NODELIST": "node1", "STEP_NUM_TASKS": "4"}.items():
        monkeypatch.setenv(f"SLURM_{name}", value)
    yield monkeypatch


def test_a_run_on_one_device_does_not_care_for_a_slurm_job_around_it(
    arguments: Arguments, alone: Path, tmp_path: Path, slurm_job: pytest.MonkeyPatch
):
    out = tmp_path / "run"
    done = subprocess.run([sys.executable, "-m", "nerf_rl.cli", *arguments(out)], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert logged(out, "train/total") == logged(alone, "train/total")


def test_srun_tells_which_process_of_the_run_this_is(slurm_job: pytest.MonkeyPatch):
    assert rank_from_outside(PretrainConfig("data", "out", devices=2, nodes=2)) == 2
    assert rank_from_outside(PretrainConfig("data", "out")) is None
    with pytest.raises(UserError, match="srun has started 4 processes, but --devices 2 on --nodes 1 needs 2"):
        rank_from_outside(PretrainConfig("data", "out", devices=2))


def test_processes_that_do_not_fit_the_keys_are_told(monkeypatch: pytest.MonkeyPatch):
    with pytest.raises(UserError, match="--nodes 2: start the command on each of them, with torchrun or srun"):
        rank_from_outside(PretrainConfig("data", "out", nodes=2))
    for name, value in {"TORCHELASTIC_RUN_ID": "1", "RANK": "1", "WORLD_SIZE": "3"}.items():
        monkeypatch.setenv(name, value)
    with pytest.raises(UserError, match="torchrun has started 3 processes, but --devices 1 on --nodes 1 needs 1"):
        rank_from_outside(PretrainConfig("data", "out"))
    assert rank_from_outside(PretrainConfig("data", "out", devices=3, scenes_per_step=3)) == 1


def test_scenes_that_cannot_be_shared_evenly_are_told():
    with pytest.raises(UserError, match=r"--scenes_per_step 32 cannot be shared evenly by 3 processes"):
        PretrainConfig("data", "out", devices=3)


def test_an_accelerator_that_is_not_there_is_told_and_nothing_is_written(
    arguments: Arguments, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
):
    monkeypatch.setattr(torch.cuda, "is_available", lambda: False)
    assert cli.main(arguments(tmp_path / "run", "--accelerator", "gpu")) == 2
    message = capsys.readouterr().err
    assert "there is no GPU here that PyTorch can use; --accelerator cpu takes any number" in message
    assert message.count("\n") == 1 and not list(tmp_path.iterdir())


@pytest.mark.parametrize("gpus", [0, 2])
def test_auto_takes_a_gpu_where_there_is_one(gpus: int, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(torch.cuda, "is_available", lambda: gpus > 0)
    monkeypatch.setattr(torch.cuda, "device_count", lambda: gpus)
    assert choose_accelerator("auto", 1) == ("cuda" if gpus else "cpu")
    assert choose_accelerator("cpu", 5) == "cpu"
    with pytest.raises(UserError, match="no GPU here" if not gpus else "only 2 GPU here"):
        choose_accelerator("gpu", 3)


def test_processes_on_one_processor_share_its_cores():
    cores = len(os.sched_getaffinity(0))
    assert thread_count(PretrainConfig("data", "out"), "cpu") is None
    assert thread_count(PretrainConfig("data", "out", devices=2), "cpu") == max(1, cores // 2)
    assert thread_count(PretrainConfig("data", "out", devices=2, threads=3), "cpu") == 3
    assert thread_count(PretrainConfig("data", "out", devices=2), "cuda") is None


def mistaken(config: PretrainConfig) -> None:
    raise UserError("one sentence")


def test_the_mistake_that_a_process_finds_is_told_by_the_command():
    with pytest.raises(UserError, match=r"^one sentence$"):
        run_on_each_device(PretrainConfig("data", "out", devices=2), mistaken)
