"""The probe command: what it prints and writes, and how it refuses."""

import json
import shutil
from pathlib import Path

import pytest

from nerf_rl import cli
from nerf_rl.files.checksummed_json import write_checksummed


def test_the_command_prints_a_table_and_writes_a_summary(
    tiny_dataset: Path, tiny_encoder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
):
    arguments = ["probe", "--encoder", str(tiny_encoder), "--data", str(tiny_dataset), "--out", str(tmp_path / "probe")]
    assert cli.main(arguments) == 0
    shown = capsys.readouterr().out
    summary = json.loads((tmp_path / "probe" / "summary.json").read_text())
    assert set(summary) == {"probe", "probe_random_encoder"}
    for name, figures in summary["probe"].items():
        row = next(line for line in shown.splitlines() if line.startswith(name))
        assert f"{figures['rmse_mm']:.1f}" in row and f"{summary['probe_random_encoder'][name]['rmse_mm']:.1f}" in row


def test_a_supervised_encoder_stands_beside_as_the_ceiling(
    tiny_dataset: Path, tiny_encoder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
):
    words = ["--encoder", str(tiny_encoder), "--data", str(tiny_dataset), "--out", str(tmp_path / "probe")]
    assert cli.main(["probe", *words, "--ceiling_steps", "3"]) == 0
    summary = json.loads((tmp_path / "probe" / "summary.json").read_text())
    ceiling = summary["probe_supervised_encoder"]
    assert set(ceiling) == set(summary["probe"])
    shown = capsys.readouterr().out
    row = next(line for line in shown.splitlines() if line.startswith("hand_x"))
    assert row.split()[-1] == f"{ceiling['hand_x']['rmse_mm']:.1f}" and "supervised encoder [mm]" in shown


def test_a_dataset_of_another_rig_is_refused_and_nothing_is_written(
    tiny_dataset: Path, tiny_encoder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
):
    other = tmp_path / "other"
    shutil.copytree(tiny_dataset, other)
    manifest = json.loads((other / "manifest.json").read_text())
    manifest["cameras"][2]["name"] = "back"
    write_checksummed(other / "manifest.json", manifest)
    out = tmp_path / "probe"
    assert cli.main(["probe", "--encoder", str(tiny_encoder), "--data", str(other), "--out", str(out)]) == 2
    message = capsys.readouterr().err
    assert "another camera rig: names" in message and "back" in message and message.count("\n") == 1
    assert not out.exists()
