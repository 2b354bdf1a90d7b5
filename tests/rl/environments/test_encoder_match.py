"""An encoder whose pictures are rendered otherwise than those it was trained on: told once, by the learner."""

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

from tiny_recipes import TINY_TRAINING

from nerf_rl.datasets.storage.reader import MultiViewDataset
from nerf_rl.files.versions import package_versions
from nerf_rl.rl.environments.encoder_match import rendering_differences

TRAININGS = """
import sys
from nerf_rl import cli

out, own, other, *keys = sys.argv[1:]
assert cli.main(["train-rl", "--encoder", own, "--out", out + "/own", *keys, "--env_steps", "50"]) == 0
print("the next", file=sys.stderr)
assert cli.main(["train-rl", "--encoder", other, "--out", out + "/other", *keys, "--env_steps", "50"]) == 0
"""


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


def test_training_with_another_renderer_warns_in_one_line(tiny_encoder: Path, tmp_path: Path):
    other = shutil.copytree(tiny_encoder, tmp_path / "encoder")
    description = json.loads((other / "encoder.json").read_text())
    description["renderer"] = "another card"
    description["packages"]["metaworld"] = "2.0"
    (other / "encoder.json").write_text(json.dumps(description))
    finished = subprocess.run(
        [sys.executable, "-c", TRAININGS, str(tmp_path), str(tiny_encoder), str(other), *TINY_TRAINING],
        capture_output=True,
        text=True,
        env={**os.environ, "OMP_NUM_THREADS": "1"},
    )
    assert finished.returncode == 0, finished.stderr
    of_own, of_other = finished.stderr.split("the next\n")
    assert "not rendered as" not in of_own
    (warning,) = [line for line in of_other.splitlines() if "not rendered as" in line]
    assert "(another card then, " in warning and "metaworld 2.0 then, " in warning
