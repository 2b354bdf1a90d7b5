"""Two pretraining runs side by side, with a thread each, so that whatever slows one of them slows the other."""

import os
import subprocess
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from nerf_rl.datasets.storage.reader import MultiViewDataset
from nerf_rl.files.json_files import read_json
from nerf_rl.files.outputs import SUMMARY

RECIPE = "pretrain/demo.yaml"
ENDLESS = "1000000"  # steps: the minutes end the run


def train_pair(
    data: Path, seed: int, minutes: float, keys: Mapping[str, Sequence[str]], folder: Path
) -> dict[str, dict[str, Any]]:
    """Train by the demo's recipe for equal times, and return the summaries with scene and seed.

    Args:
        data: dataset.
        seed: of the trainings.
        minutes: of each.
        keys: what a run of this name has beside the recipe.
        folder: for a run folder of each name.
    """
    words = ["--config", RECIPE, "--data", str(data), "--seed", str(seed), "--threads", "1"]
    words += ["--steps", ENDLESS, "--max_minutes", str(minutes), "--overwrite", "true"]
    command, alone = [sys.executable, "-m", "nerf_rl.cli", "pretrain", *words], {**os.environ, "OMP_NUM_THREADS": "1"}
    processes = [
        subprocess.Popen([*command, *own, "--out", str(folder / name)], env=alone) for name, own in keys.items()
    ]
    codes = [process.wait() for process in processes]
    if any(codes):
        raise SystemExit("a run failed")
    scene = MultiViewDataset(data).manifest["scene"]["name"]
    return {name: {"scene": scene, "seed": seed, **read_json(folder / name / SUMMARY)} for name in keys}
