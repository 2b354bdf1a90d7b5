"""Measure a whole generation at full size: 14,400 frames of drawer-open from three cameras at 128 x 128.

Run from a checkout's root with nothing else running; some minutes on two cores:

    .venv/bin/python -m tools.bench.generation --json datasets/results/generation.json
"""

import argparse
import sys
import tempfile
from pathlib import Path

from nerf_rl import cli
from nerf_rl.datasets.storage.reader import MultiViewDataset
from nerf_rl.files.json_files import read_json, write_json
from nerf_rl.files.outputs import SUMMARY
from nerf_rl.files.versions import git_revision, package_versions

EPISODES, FRAMES_PER_EPISODE, SIZE, WORKERS = 2400, 6, 128, 2


def main() -> None:
    """Generate, check, print and write."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--json", type=Path, help="result file to write")
    parser.add_argument("--scratch", type=Path, help="folder for the dataset (1.5 GB); a temporary one by default")
    arguments = parser.parse_args()
    keys = {"episodes": EPISODES, "frames_per_episode": FRAMES_PER_EPISODE, "size": SIZE, "workers": WORKERS}
    words = [word for key, value in keys.items() for word in (f"--{key}", str(value))]
    with tempfile.TemporaryDirectory(dir=arguments.scratch) as scratch:
        out = Path(scratch, "data")
        if cli.main(["gen-dataset", "--out", str(out), *words]) or cli.main(["check", str(out)]):
            sys.exit("the dataset was not made, or is not whole")
        summary, views = read_json(out / SUMMARY), len(MultiViewDataset(out).camera_names)
    result = {
        "command": " ".join(["python -m tools.bench.generation", *sys.argv[1:]]),
        "git_revision": git_revision(),
        "packages": package_versions(),
        "keys": keys,
        "views_per_frame": views,
        **summary,
    }
    print(result)
    if arguments.json:
        write_json(arguments.json, result)


if __name__ == "__main__":
    main()
