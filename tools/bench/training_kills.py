"""Kill agents' training at random moments with SIGKILL, resume it, and count the policies that end bit-equal.

Run from a checkout's root; it writes rl/results/kills.json (a quarter of an hour or more on two cores):

    .venv/bin/python -m tools.bench.training_kills
    .venv/bin/python -m tools.bench.training_kills --kills 20 --encoder runs/demo/encoder
"""

import argparse
import contextlib
import csv
import os
import random
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections import Counter
from pathlib import Path
from typing import Any

from nerf_rl.files.json_files import read_json, write_json
from nerf_rl.files.outputs import SUMMARY
from nerf_rl.files.versions import git_revision, package_versions

RECIPE = "rl/drawer-open.yaml"
KEYS = {"env_steps": 1200, "warmup_steps": 300, "episode_steps": 60, "checkpoint_every": 200, "evaluation_every": 400}
KEYS |= {"evaluation_episodes": 1, "final_evaluation_episodes": 2, "log_every": 100}
POLICY, METRICS = "policy.safetensors", "metrics.csv"
SILENT: dict[str, Any] = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
CLOCKS = {"seconds", "updates_per_second"}


def main() -> None:
    """Make the run to compare with, then kill and resume; record the counts after each.

    Half of the moments are uniform in the time that a run takes, half in the shorter time in which it learns.
    """
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--kills", type=int, default=50)
    parser.add_argument("--encoder", default="none", help="the run folder of one; none for the true state")
    parser.add_argument("--seed", type=int, default=0, help="of the moments")
    parser.add_argument("--out", type=Path, default=Path("rl/results/kills.json"))
    options = parser.parse_args()
    rng, revision = random.Random(options.seed), git_revision()
    with tempfile.TemporaryDirectory() as scratch:
        reference, killed = Path(scratch, "reference"), Path(scratch, "killed")
        begun = time.monotonic()
        subprocess.run(command(reference, options.encoder), check=True, **SILENT)
        undisturbed, learning = time.monotonic() - begun, read_json(reference / SUMMARY)["seconds"]
        moments: Counter[str] = Counter()
        equal = 0
        for number in range(1, options.kills + 1):
            process = subprocess.Popen(command(killed, options.encoder), start_new_session=True, **SILENT)
            while number % 2 and process.poll() is None and not (killed / METRICS).exists():
                time.sleep(0.001)
            time.sleep(rng.uniform(0.0, learning if number % 2 else undisturbed))
            with contextlib.suppress(ProcessLookupError):
                os.killpg(process.pid, signal.SIGKILL)
            process.wait()
            moments[stage(killed)] += 1
            resumed = command(killed, options.encoder, "--resume", "true")
            subprocess.run(resumed, check=True, **SILENT)
            equal += learnt(killed) == learnt(reference)
            shutil.rmtree(killed)
            print(f"{number} kills: {equal} bit-equal", flush=True)
            result = {
                "command": " ".join(["python -m tools.bench.training_kills", *sys.argv[1:]]),
                "git_revision": revision,
                "packages": package_versions(),
                "recipe": RECIPE,
                "keys": KEYS,
                "undisturbed_seconds": round(undisturbed, 1),
                "kills": number,
                "bit_equal": equal,
                "moments": dict(moments),
            }
            write_json(options.out, result)


def command(out: Path, encoder: str, *arguments: str) -> list[str]:
    """Return the command line of a short run."""
    keys = [word for key, value in KEYS.items() for word in (f"--{key}", str(value))]
    words = ["train-rl", "--config", RECIPE, "--encoder", encoder, "--out", str(out), *keys, *arguments]
    return [sys.executable, "-m", "nerf_rl.cli", *words]


def stage(run: Path) -> str:
    """Tell how far a run had come."""
    if (run / SUMMARY).exists():
        return "after its end"
    if not (run / METRICS).exists():
        return "before its first step was told"
    return "among checkpoints" if any((run / "checkpoints").glob("*")) else "before its first checkpoint"


def learnt(run: Path) -> tuple[bytes, list[dict[str, Any]], list[dict[str, str]]]:
    """Return the policy's bytes, the evaluations, and what was logged of the learning, but for clocks."""
    with (run / METRICS).open() as file:
        rows = [{name: value for name, value in row.items() if name not in CLOCKS} for row in csv.DictReader(file)]
    return (run / POLICY).read_bytes(), read_json(run / SUMMARY)["evaluations"], rows


if __name__ == "__main__":
    main()
