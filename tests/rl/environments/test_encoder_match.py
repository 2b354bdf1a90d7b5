"""An encoder whose pictures are rendered otherwise than those it was trained on: told once, by the learner."""

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from tiny_recipes import TINY_TRAINING

from nerf_rl.datasets.storage.reader import MultiViewDataset
from nerf_rl.files.versions import package_versions
from nerf_rl.rl.environments.encoder_match import rendering_differences


def test_the_description_records_what_rendered_the_dataset(tiny_encoder: Path, tiny_dataset: Path):
    description = json.loads((tiny_encoder / "encoder.json").read_text())
    manifest = MultiViewDataset(tiny_dataset).manifest
    assert description["renderer"] == manifest["renderer"]
    assert description["packages"]["mujoco"] == manifest["packages"]["mujoco"]


def test_what_differs_is_named_and_what_is_unknown_is_not():
    versions = package_versions()
    assert rendering_differences("card A and card B", versions, "card B") == []
    assert rendering_differences("", {}, "card B") == []
    assert rendering_differences("card A", {"mujoco": "2.9"}, "card B") == [
        "card A then, card B here",
        f"mujoco 2.9 then, {versions['mujoco']} here",
    ]


@pytest.mark.parametrize("other", [True, False])
def test_training_with_another_renderer_warns_in_one_line(tiny_encoder: Path, tmp_path: Path, other: bool):
    run = shutil.copytree(tiny_encoder, tmp_path / "encoder")
    description = json.loads((run / "encoder.json").read_text())
    if other:
        description["renderer"] = "another card"
        description["packages"]["metaworld"] = "2.0"
    (run / "encoder.json").write_text(json.dumps(description))
    arguments = ["--encoder", str(run), "--out", str(tmp_path / "agent"), *TINY_TRAINING, "--env_steps", "50"]
    finished = subprocess.run(
        [sys.executable, "-m", "nerf_rl.cli", "train-rl", *arguments],
        capture_output=True,
        text=True,
        env={**os.environ, "OMP_NUM_THREADS": "1"},
    )
    assert finished.returncode == 0, finished.stderr
    warnings = [line for line in finished.stderr.splitlines() if "not rendered as" in line]
    assert len(warnings) == (1 if other else 0)
    if other:
        assert "(another card then, " in warnings[0] and "metaworld 2.0 then, " in warnings[0]
