"""Load an export with LeRobot itself, train its smallest policy on it, and read it with its viewer.

LeRobot needs an older torch than nerf-rl, so it runs in an environment of its own:

    python3.12 -m venv lerobot && lerobot/bin/pip install "lerobot[training,viz]>=0.6"
    lerobot/bin/python tools/check_lerobot.py EXPORT --steps 100 --viewer true
"""

import argparse
import json
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np
from lerobot.datasets import LeRobotDataset

REPOSITORY = "local/export"
TINY_ACT = {
    "policy.type": "act",
    "policy.device": "cpu",
    "policy.push_to_hub": "false",
    "policy.pretrained_backbone_weights": "null",
    "policy.dim_model": 32,
    "policy.n_heads": 2,
    "policy.dim_feedforward": 64,
    "policy.n_encoder_layers": 1,
    "policy.n_vae_encoder_layers": 1,
    "policy.chunk_size": 8,
    "policy.n_action_steps": 8,
    "batch_size": 4,
    "num_workers": 0,
    "log_freq": 10,
    "save_checkpoint": "false",
    "wandb.enable": "false",
}


def main() -> None:
    """Check one export."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("export", type=Path, help="folder that nerf-rl export --format lerobot wrote")
    parser.add_argument("--frames", type=int, nargs="+", default=[0], help="frames to load")
    parser.add_argument("--dump", type=Path, help="file to write the loaded frames to (.npz), with depth in metres")
    parser.add_argument("--steps", type=int, default=0, help="training steps")
    parser.add_argument("--viewer", default="false", choices=["true", "false"], help="read episode 0 into rerun")
    arguments = parser.parse_args()
    load(arguments.export, arguments.frames, arguments.dump)
    with tempfile.TemporaryDirectory() as folder:
        if arguments.steps:
            train(arguments.export, arguments.steps, Path(folder) / "run")
        if arguments.viewer == "true":
            view(arguments.export, Path(folder))


def load(export: Path, frames: list[int], dump: Path | None) -> None:
    """Load frames, and write them to a file if there is one to write to."""
    dataset = LeRobotDataset(REPOSITORY, root=export, video_backend="pyav", depth_output_unit="m")
    items = [dataset[frame] for frame in frames]
    print(f"LeRobot reads {len(dataset)} frames of {dataset.num_episodes} episodes: {', '.join(dataset.features)}")
    if dump is not None:
        np.savez(dump, **{key: np.stack([item[key].numpy() for item in items]) for key in dataset.features})


def train(export: Path, steps: int, run: Path) -> None:
    """Train a tiny ACT on state and colours; depth has one channel, and ACT takes three."""
    features = json.loads((export / "meta/info.json").read_text())["features"]
    wanted = {"observation.state": {"type": "STATE", "shape": features["observation.state"]["shape"]}}
    for key, feature in features.items():
        if feature["dtype"] == "video" and not feature["info"]["is_depth_map"]:
            height, width, channels = feature["shape"]
            wanted[key] = {"type": "VISUAL", "shape": [channels, height, width]}
    keys = TINY_ACT | {
        "dataset.repo_id": REPOSITORY,
        "dataset.root": export,
        "dataset.video_backend": "pyav",
        "policy.input_features": json.dumps(wanted),
        "steps": steps,
        "output_dir": run,
    }
    script = [sys.executable, "-m", "lerobot.scripts.lerobot_train"]
    subprocess.run([*script, *(f"--{key}={value}" for key, value in keys.items())], check=True)


def view(export: Path, folder: Path) -> None:
    """Let LeRobot's viewer read the first episode, and find what it wrote for rerun."""
    script = [sys.executable, "-m", "lerobot.scripts.lerobot_dataset_viz"]
    place = ["--repo-id", REPOSITORY, "--root", str(export), "--episode-index", "0", "--num-workers", "0"]
    subprocess.run([*script, *place, "--save", "1", "--output-dir", str(folder)], check=True)
    (written,) = folder.glob("*.rrd")
    print(f"rerun's recording of episode 0 has {written.stat().st_size} bytes")


if __name__ == "__main__":
    main()
