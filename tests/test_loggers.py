"""Curves beside metrics.csv: TensorBoard by default, a logger of one's own, and names that there are not."""

import json
import subprocess
import sys
from pathlib import Path

import pytest
from tensorboard.backend.event_processing.event_accumulator import EventAccumulator
from tiny_recipes import TINY_TRAINING

from nerf_rl import cli

OWN = """
import json
from lightning.pytorch.loggers.logger import DummyLogger


class Lines(DummyLogger):
    def __init__(self, run):
        super().__init__()
        self.file = run / "lines.jsonl"

    def log_metrics(self, metrics, step=None):
        with open(self.file, "a") as file:
            file.write(json.dumps({"step": step, **metrics}) + "\\n")


def broken(run):
    raise ConnectionError("no server")
"""


def scalars(folder: Path) -> EventAccumulator:
    return EventAccumulator(str(folder)).Reload()


def train(out: Path, *arguments: str) -> int:
    return cli.main(["train-rl", "--out", str(out), "--log_every", "20", *TINY_TRAINING, *arguments])


def test_an_agents_curves_are_in_tensorboard_by_environment_steps_without_lightning(tmp_path: Path):
    words = ["train-rl", "--out", str(tmp_path / "run"), "--log_every", "20", *TINY_TRAINING]
    program = f"import sys; from nerf_rl import cli; sys.exit(cli.main({words!r}) or 'lightning' in sys.modules)"
    subprocess.run([sys.executable, "-c", program], check=True)
    curves = scalars(tmp_path / "run" / "logs")
    assert {"train/q", "train/noise", "evaluation/success_rate"} <= set(curves.Tags()["scalars"])
    summary = json.loads((tmp_path / "run" / "summary.json").read_text())
    evaluations = [(point.step, point.value) for point in curves.Scalars("evaluation/mean_return")]
    expected = [(e["env_steps"], pytest.approx(e["mean_return"], rel=1e-5)) for e in summary["evaluations"]]
    assert evaluations == expected


def test_an_encoders_curves_are_there_too(tiny_encoder: Path):
    assert "validation/psnr_db" in scalars(tiny_encoder / "logs").Tags()["scalars"]


def test_a_logger_of_ones_own_stands_in_a_file_outside_the_package(
    tiny_dataset: Path, tiny_pretraining_recipe: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    (tmp_path / "own_logger.py").write_text(OWN)
    monkeypatch.syspath_prepend(str(tmp_path))
    keys = ["--loggers", "[own_logger:Lines]", "--log_every", "1"]
    words = ["--config", str(tiny_pretraining_recipe), "--data", str(tiny_dataset), "--out", str(tmp_path / "encoder")]
    assert cli.main(["pretrain", *words, *keys]) == 0
    assert train(tmp_path / "agent", *keys[:2]) == 0
    for run, name in (("encoder", "train/total"), ("agent", "train/q")):
        rows = [json.loads(line) for line in (tmp_path / run / "lines.jsonl").read_text().splitlines()]
        assert any(name in row for row in rows)
        assert not list((tmp_path / run).rglob("events.out.tfevents.*"))


@pytest.mark.parametrize("command", ["pretrain", "train-rl"])
@pytest.mark.parametrize(
    "name, message",
    [
        (
            "tensorbord",
            "unknown logger 'tensorbord' (did you mean tensorboard?); available: mlflow, tensorboard, wandb",
        ),
        ("nowhere:Logger", "logger 'nowhere:Logger' cannot be had: ModuleNotFoundError: No module named 'nowhere'"),
        ("json:Logger", "logger 'json:Logger' cannot be had: AttributeError: module 'json' has no attribute 'Logger'"),
        ("pathlib:Path", "'pathlib:Path' is no logger: it lacks log_metrics, save, finalize"),
    ],
)
def test_a_logger_that_there_is_not_is_told_before_anything_is_written(
    command: str, name: str, message: str, tiny_dataset: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
):
    data = ["--data", str(tiny_dataset)] if command == "pretrain" else []
    assert cli.main([command, *data, "--out", str(tmp_path / "run"), "--loggers", f"[{name}]"]) == 2
    assert message in capsys.readouterr().err
    assert not (tmp_path / "run").exists()


def test_weights_and_biases_needs_its_extra(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.setitem(__import__("sys").modules, "wandb", None)
    assert train(tmp_path / "run", "--loggers", "[wandb]") == 2
    assert "--loggers wandb needs the extra 'wandb'" in capsys.readouterr().err


def test_weights_and_biases_keeps_a_run_here_without_a_network(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
):
    pytest.importorskip("wandb", reason="the extra wandb is not installed")
    for name, text in {"WANDB_MODE": "offline", "WANDB_SILENT": "true", "WANDB_DIR": ""}.items():
        monkeypatch.setenv(name, text)
    for name in ("first", "second"):  # in one process, which must not be taken for one run
        assert train(tmp_path / name, "--loggers", "[wandb]") == 0
        (kept,) = (tmp_path / name / "wandb").glob("offline-run-*/run-*.wandb")
        content = kept.read_bytes()
        assert b"train/critic_loss" in content and b"evaluation/mean_return" in content


@pytest.mark.parametrize("command", ["pretrain", "train-rl"])
def test_mlflow_keeps_a_run_here_without_a_server(
    command: str,
    tiny_dataset: Path,
    tiny_pretraining_recipe: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
):
    tracking = pytest.importorskip("mlflow.tracking", reason="the extra mlflow is not installed")
    monkeypatch.delenv("MLFLOW_TRACKING_URI", raising=False)
    run = tmp_path / "run"
    if command == "train-rl":
        assert train(run, "--loggers", "[mlflow]") == 0
        name = "evaluation/mean_return"
    else:
        keys = ["--config", str(tiny_pretraining_recipe), "--data", str(tiny_dataset), "--out", str(run)]
        assert cli.main(["pretrain", *keys, "--loggers", "[mlflow]", "--log_every", "1"]) == 0
        name = "validation/psnr_db"
    client = tracking.MlflowClient(f"sqlite:///{run / 'mlflow.db'}")
    experiment = client.get_experiment_by_name("nerf-rl")
    (kept,) = client.search_runs([experiment.experiment_id])
    assert kept.info.run_name == "run" and kept.info.status == "FINISHED"
    history = client.get_metric_history(kept.info.run_id, name)
    if command == "train-rl":
        summary = json.loads((run / "summary.json").read_text())
        expected = [(e["env_steps"], pytest.approx(e["mean_return"])) for e in summary["evaluations"]]
        assert [(point.step, point.value) for point in sorted(history, key=lambda point: point.step)] == expected
    else:
        assert history


def test_mlflow_needs_its_extra(tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setitem(__import__("sys").modules, "mlflow", None)
    assert train(tmp_path / "run", "--loggers", "[mlflow]") == 2
    assert "--loggers mlflow needs the extra 'mlflow'" in capsys.readouterr().err
