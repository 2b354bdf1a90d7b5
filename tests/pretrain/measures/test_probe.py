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
    assert "was trained on" not in shown
    summary = json.loads((tmp_path / "probe" / "summary.json").read_text())
    assert set(summary) == {f"{kind}{whose}" for kind in ("probe", "joint_probe") for whose in ("", "_random_encoder")}
    for kind, error in (("probe", "rmse_mm"), ("joint_probe", "rmse_deg")):
        for name, figures in summary[kind].items():
            row = next(line for line in shown.splitlines() if line.startswith(f"{name} "))
            told = [figures, summary[f"{kind}_random_encoder"][name]]
            error = error if error in figures else "rmse_mm"
            for value in [each[f"{probe}{error}"] for each in told for probe in ("", "network_")]:
                assert f"{value:.1f}" in row


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
    errors = (f"{ceiling['hand_x'][name]:.1f} mm" for name in ("rmse_mm", "network_rmse_mm"))
    assert row.endswith(", ".join(errors)) and "supervised encoder" in shown


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


def test_a_dataset_of_another_scene_is_probed_and_told(
    tiny_dataset: Path, tiny_encoder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
):
    other = tmp_path / "other"
    shutil.copytree(tiny_dataset, other)
    manifest = json.loads((other / "manifest.json").read_text())
    trained_on, manifest["scene"]["name"] = manifest["scene"]["name"], "metaworld/faucet-open-v3"
    write_checksummed(other / "manifest.json", manifest)
    assert cli.main(["probe", "--encoder", str(tiny_encoder), "--data", str(other)]) == 0
    first, *table = capsys.readouterr().out.splitlines()
    assert first == f"{tiny_encoder} was trained on {trained_on}, and {other} shows metaworld/faucet-open-v3"
    assert any(line.startswith("hand_x ") for line in table)


def test_what_cannot_be_probed_does_not_cost_an_earlier_result(
    tiny_dataset: Path, tiny_encoder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
):
    encoder, out = Path(shutil.copytree(tiny_encoder, tmp_path / "encoder")), tmp_path / "probe"
    words = ["probe", "--encoder", str(encoder), "--data", str(tiny_dataset), "--out", str(out)]
    assert cli.main(words) == 0
    before = (out / "summary.json").read_bytes()
    (encoder / "encoder.safetensors").write_bytes(b"cut off")
    assert cli.main(words) == 2 and "already exists" in capsys.readouterr().err
    assert cli.main([*words, "--overwrite", "true"]) == 2
    assert (out / "summary.json").read_bytes() == before
