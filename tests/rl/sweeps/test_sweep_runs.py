"""Sweeps over seeds as the command line runs them: whole, killed in between, with a seed that fails."""

import contextlib
import csv
import json
import os
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from nerf_rl import cli
from nerf_rl.files.outputs import write_provenance
from nerf_rl.rl.sweeps.runs import read_run

ROOT = Path(__file__).parents[3]
TINY = ["--config", str(ROOT / "rl" / "gym.yaml"), "--env_steps", "900", "--warmup_steps", "60", "--envs", "1"]
TINY += ["--episode_steps", "30", "--learner.batch_size", "8", "--network.hidden", "[16, 16]"]
TINY += ["--evaluation_every", "300", "--evaluation_episodes", "1", "--final_evaluation_episodes", "2"]
TINY += ["--checkpoint_every", "50", "--log_every", "100"]
SWEEP = [*TINY, "--seeds", "0..1", "--workers", "2"]


@pytest.fixture(scope="module")
def undisturbed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A whole sweep; tests leave it as it is."""
    out = tmp_path_factory.mktemp("sweep") / "whole"
    assert cli.main(["train-rl", *SWEEP, "--out", str(out)]) == 0
    return out


def start(out: Path, *arguments: str) -> subprocess.Popen:
    """Start a sweep in a session of its own, as a terminal would."""
    program = [sys.executable, "-m", "nerf_rl.cli", "train-rl", *SWEEP, "--out", str(out), *arguments]
    return subprocess.Popen(program, start_new_session=True, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)


def newest_checkpoint(out: Path, runs: str) -> int:
    """Return the environment steps of the newest checkpoint of some runs, 0 if there is none."""
    return max((int(folder.name) for folder in out.glob(f"{runs}/checkpoints/[0-9]*")), default=0)


def wait_for_a_checkpoint(out: Path, runs: str, before: int, process: subprocess.Popen) -> None:
    """Wait until one of the runs has a checkpoint of more than ``before`` environment steps."""
    for _ in range(60_000):
        if newest_checkpoint(out, runs) > before:
            return
        assert process.poll() is None
        time.sleep(0.01)
    raise AssertionError("no checkpoint came")


def process_of(out: Path, seed: int) -> int:
    """Return the process that trains a seed: the first of those that write to its log."""
    log = str(out / "logs" / f"seed-{seed}.log")
    writing = []
    for folder in Path("/proc").glob("[0-9]*"):
        with contextlib.suppress(OSError):  # it ended meanwhile
            if os.readlink(folder / "fd" / "1") == log:
                writing.append(int(folder.name))
    return min(writing)


def results(run: Path) -> tuple[bytes, list, list]:
    """Return what must not depend on interruptions: the policy, the evaluations, the scalars but times."""
    with open(run / "metrics.csv", newline="") as file:
        rows = [{k: v for k, v in row.items() if "second" not in k} for row in csv.DictReader(file)]
    return (
        (run / "policy.safetensors").read_bytes(),
        json.loads((run / "summary.json").read_text())["evaluations"],
        rows,
    )


def test_each_seed_is_the_run_that_it_would_be_alone(undisturbed: Path, tmp_path: Path):
    alone = tmp_path / "alone"
    assert cli.main(["train-rl", *TINY, "--out", str(alone), "--seed", "1"]) == 0
    assert results(undisturbed / "seed-1") == results(alone)
    assert {path.name for path in (undisturbed / "seed-1").iterdir()} == {path.name for path in alone.iterdir()}
    assert results(undisturbed / "seed-0") != results(alone)
    assert any((undisturbed / "seed-1" / "logs").rglob("events.out.tfevents*"))
    keys = ["--run", str(undisturbed / "seed-1"), "--out", str(tmp_path / "evaluation"), "--episodes", "2"]
    assert cli.main(["evaluate", *keys]) == 0


def test_a_sweep_leaves_a_summary_of_its_seeds_and_a_figure(undisturbed: Path):
    names = {path.name for path in undisturbed.iterdir()}
    files = {"config.yaml", "provenance.json", "summary.json", "learning_curves.png", "logs"}
    assert names == files | {"seed-0", "seed-1"}
    summary = json.loads((undisturbed / "summary.json").read_text())
    assert (summary["seeds"], summary["unfinished"], summary["score"]) == ("0..1", [], "mean_return")
    assert [run["seed"] for run in summary["runs"]] == [0, 1]
    assert [(point["env_steps"], point["seeds"]) for point in summary["curve"]] == [(300, 2), (600, 2), (900, 2)]
    last = [run["evaluations"][-1]["mean_return"] for run in summary["runs"]]
    assert summary["final"]["iqm"] == pytest.approx(sum(last) / 2)
    assert summary["final"]["iqm_low"] == min(last) and summary["final"]["iqm_high"] == max(last)
    assert (undisturbed / "learning_curves.png").read_bytes()[:4] == b"\x89PNG"


def test_killed_as_a_whole_and_in_part_a_sweep_ends_as_the_undisturbed_one(
    undisturbed: Path, tmp_path: Path, capfd: pytest.CaptureFixture[str]
):
    out = tmp_path / "killed"
    process = start(out)
    wait_for_a_checkpoint(out, "seed-*", 0, process)
    process.kill()  # what it started is left alone
    process.communicate()
    assert not (out / "summary.json").exists()

    before = newest_checkpoint(out, "seed-1")
    process = start(out, "--resume", "true")
    wait_for_a_checkpoint(out, "seed-1", before, process)
    os.kill(process_of(out, 1), signal.SIGKILL)
    shown, told = process.communicate(timeout=600)
    assert process.returncode == 1
    assert told == (
        "nerf-rl train-rl: 1 of 2 seeds failed: 1 (ended by SIGKILL); what they said is in "
        f"{out / 'logs'}: seed-1.log; the others are kept: go on with --resume true\n"
    )
    assert "\nseed 1 failed, ended by SIGKILL; " in shown and "\nseed 0, " in shown
    summary = json.loads((out / "summary.json").read_text())
    assert summary["unfinished"] == [1] and [run["seed"] for run in summary["runs"]] == [0]

    assert cli.main(["train-rl", *SWEEP, "--out", str(out), "--resume", "true"]) == 0
    assert "train-rl writes 2 seeds to" in (shown := capfd.readouterr().out) and ", 1 of them finished\n" in shown
    for seed in ("seed-0", "seed-1"):
        assert results(out / seed) == results(undisturbed / seed)


def test_a_seed_that_fails_stops_no_other_and_its_error_is_found(
    undisturbed: Path, tmp_path: Path, capfd: pytest.CaptureFixture[str]
):
    out = tmp_path / "failing"
    shutil.copytree(undisturbed, out)
    (out / "seed-0" / "summary.json").unlink()
    (out / "seed-0" / "checkpoints" / "00000900" / "state.json").write_text("{")
    before = (out / "seed-1" / "summary.json").stat().st_mtime_ns
    assert cli.main(["train-rl", *SWEEP, "--seeds", "0..2", "--out", str(out), "--resume", "true"]) == 1
    shown = capfd.readouterr()
    assert "1 of 3 seeds failed: 0 (exit code 2)" in shown.err and "seed-0.log" in shown.err
    assert "its state.json is damaged" in shown.out  # its last line
    assert "its state.json is damaged" in (out / "logs" / "seed-0.log").read_text()
    assert (out / "seed-1" / "summary.json").stat().st_mtime_ns == before  # finished ones are kept
    summary = json.loads((out / "summary.json").read_text())
    assert summary["unfinished"] == [0] and [run["seed"] for run in summary["runs"]] == [1, 2]


def test_a_seed_whose_log_cannot_be_written_fails_and_is_named(
    undisturbed: Path, tmp_path: Path, capfd: pytest.CaptureFixture[str]
):
    out = tmp_path / "without_logs"
    shutil.copytree(undisturbed, out)
    (out / "seed-0" / "summary.json").unlink()
    shutil.rmtree(out / "logs")
    (out / "logs").write_text("no folder")
    assert cli.main(["train-rl", *SWEEP, "--out", str(out), "--resume", "true"]) == 1
    assert "1 of 2 seeds failed: 0 (exit code 1)" in capfd.readouterr().err


@pytest.mark.parametrize(
    ("keys", "sentence"),
    [
        (["--seeds", "0..1"], "already exists and is not empty; use --overwrite true or another --out"),
        (["--seeds", "1..2", "--resume", "true"], "was begun with --seeds 0..1, and seed 0 would be left out"),
        (["--seeds", "0..1", "--resume", "true", "--learner.gamma", "0.5"], "was begun with another --learner"),
        (["--resume", "true"], "holds runs of several seeds; resume them with --seeds 0..1, or use another --out"),
    ],
)
def test_a_folder_with_a_sweep_is_not_taken_for_anything_else(
    undisturbed: Path, keys: list[str], sentence: str, capsys: pytest.CaptureFixture[str]
):
    before = sorted(path.stat().st_mtime_ns for path in undisturbed.rglob("*"))
    assert cli.main(["train-rl", *TINY, "--out", str(undisturbed), *keys]) == 2
    assert sentence in capsys.readouterr().err
    assert sorted(path.stat().st_mtime_ns for path in undisturbed.rglob("*")) == before


@pytest.mark.parametrize("command", ["gen-dataset", "tune"])
@pytest.mark.parametrize("theirs", [[], ["--seeds", "0"]], ids=["without seeds", "with seeds"])
@pytest.mark.parametrize("seeds", [[], ["--seeds", "0"]], ids=["one run", "a sweep"])
def test_a_folder_of_another_command_is_not_gone_on_with_whatever_its_keys_are(
    command: str, theirs: list[str], seeds: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
):
    out = tmp_path / "out"
    out.mkdir()
    write_provenance(out, command, cli.parse("train-rl", [*TINY, *theirs, "--out", str(out)]))
    before = {path: path.read_bytes() for path in out.iterdir()}
    assert cli.main(["train-rl", *TINY, *seeds, "--out", str(out), "--resume", "true"]) == 2
    assert "already exists and is not empty" in capsys.readouterr().err
    assert {path: path.read_bytes() for path in out.iterdir()} == before


def test_where_one_run_is_asked_for_a_sweep_names_those_that_it_holds(
    undisturbed: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
):
    assert cli.main(["evaluate", "--run", str(undisturbed), "--out", str(tmp_path / "evaluation")]) == 2
    sentence = f"it holds runs of several seeds; give the folder of one, such as {undisturbed / 'seed-0'}"
    assert sentence in capsys.readouterr().err


def test_a_sweep_of_a_baseline_whose_runs_have_ended_is_not_made_longer(
    undisturbed: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
):
    pytest.importorskip("stable_baselines3")
    out = shutil.copytree(undisturbed, tmp_path / "ppo")
    for file in (out / "config.yaml", *out.glob("seed-*/config.yaml")):
        file.write_text(file.read_text().replace("algo: ddpg", "algo: ppo"))
    before = {path: path.stat().st_mtime_ns for path in out.rglob("*")}
    longer = ["--algo", "ppo", "--env_steps", "1200", "--resume", "true"]
    assert cli.main(["train-rl", *SWEEP, "--out", str(out), *longer]) == 2
    assert "--algo ppo cannot go on with a run that has ended, as seeds 0, 1 of" in capsys.readouterr().err
    assert {path: path.stat().st_mtime_ns for path in out.rglob("*")} == before


def test_a_longer_run_knows_when_its_evaluation_at_the_earlier_end_was_due(tmp_path: Path):
    run, keys = tmp_path / "run", ["--envs", "2", "--evaluation_every", "300", "--evaluation_episodes", "1"]
    for steps, words in (("311", []), ("600", ["--resume", "true"])):
        assert cli.main(["train-rl", *TINY, *keys, "--env_steps", steps, "--out", str(run), *words]) == 0
    evaluations = read_run(run)["evaluations"]
    assert [evaluation["due"] for evaluation in evaluations] == [300, 311, 600]
    assert evaluations[1]["env_steps"] > 311  # both environments step at once


def test_a_sweep_that_is_made_longer_says_from_then_on_what_is_unfinished(
    undisturbed: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    def interrupted(*arguments):  # before a seed has ended
        raise KeyboardInterrupt
        yield

    out = shutil.copytree(undisturbed, tmp_path / "sweep")
    monkeypatch.setattr("nerf_rl.rl.sweeps.sweep.train_seeds_apart", interrupted)
    assert cli.main(["train-rl", *SWEEP, "--out", str(out), "--env_steps", "1200", "--resume", "true"]) == 130
    summary = json.loads((out / "summary.json").read_text())
    assert summary["unfinished"] == [0, 1] and not summary["runs"] and summary["final"] is None
    assert not (out / "learning_curves.png").exists()


@pytest.mark.parametrize(
    ("name", "content"),
    [("provenance.json", "{}"), ("provenance.json", "[1"), ("config.yaml", "env_steps: ["), ("config.yaml", "9")],
)
def test_a_finished_seed_whose_records_are_damaged_counts_as_unfinished(
    name: str, content: str, undisturbed: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    def interrupted(train, config, seeds, *others):
        asked.append(list(seeds))
        raise KeyboardInterrupt
        yield

    out, asked = shutil.copytree(undisturbed, tmp_path / "sweep"), []
    (out / "seed-1" / name).write_text(content)
    monkeypatch.setattr("nerf_rl.rl.sweeps.sweep.train_seeds_apart", interrupted)
    assert cli.main(["train-rl", *SWEEP, "--out", str(out), "--resume", "true"]) == 130
    assert asked == [[1]] and json.loads((out / "summary.json").read_text())["unfinished"] == [1]


def test_a_single_run_does_not_become_a_sweep(undisturbed: Path, capsys: pytest.CaptureFixture[str]):
    out = str(undisturbed / "seed-0")
    assert cli.main(["train-rl", *TINY, "--out", out, "--seeds", "0..1", "--resume", "true"]) == 2
    assert f"{out} holds a single run; use another --out for several seeds" in capsys.readouterr().err
