"""Generate and check a small dataset of every Meta-World task and of other MuJoCo scenes, with their own cameras.

Run from a checkout's root; it writes datasets/results/scenes.json and the table in datasets/README.md (minutes):

    .venv/bin/python -m tools.bench.scenes
    .venv/bin/python -m tools.bench.scenes gym/Ant-v5 metaworld/soccer-v3    # prints these alone, writes nothing
"""

import argparse
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

from nerf_rl.files.json_files import read_json, write_json
from nerf_rl.files.outputs import SUMMARY
from nerf_rl.files.versions import git_revision, package_versions
from nerf_rl.scenes.base import GYM, METAWORLD
from tools.page_tables import markdown_table, write_tables

_GYMNASIUM = (
    *("Ant", "HalfCheetah", "Hopper", "Humanoid", "HumanoidStandup", "InvertedDoublePendulum", "InvertedPendulum"),
    *("Pusher", "Reacher", "Swimmer", "Walker2d"),
)
_ROBOTICS = (
    *("FetchPickAndPlace-v4", "FetchPush-v4", "FetchReach-v4", "FetchSlide-v4", "HandReach-v3"),
    *("HandManipulateBlock-v1", "HandManipulateEgg-v1", "HandManipulatePen-v1", "AdroitHandDoor-v1"),
    *("AdroitHandHammer-v1", "AdroitHandPen-v1", "AdroitHandRelocate-v1", "FrankaKitchen-v1", "AntMaze_UMaze-v5"),
)
_DM_CONTROL = (
    *("acrobot-swingup", "ball_in_cup-catch", "cartpole-balance", "cheetah-run", "dog-fetch", "finger-turn_hard"),
    *("fish-swim", "hopper-hop", "humanoid-run", "humanoid_CMU-run", "lqr-lqr_2_1", "manipulator-bring_ball"),
    *("manipulator-insert_peg", "pendulum-swingup", "point_mass-easy", "reacher-easy"),
    *("stacker-stack_2", "swimmer-swimmer6", "walker-walk", "lift_brick_features", "place_cradle_features"),
    *("reach_duplo_features", "stack_2_bricks_features"),
)
OTHERS = [
    "datasets/scenes/blocks.xml",
    *(f"{GYM}{name}-v5" for name in _GYMNASIUM),
    *(f"{GYM}gymnasium_robotics:{name}" for name in _ROBOTICS),
    *(f"{GYM}shimmy:dm_control/{name}-v0" for name in _DM_CONTROL),
]
SIZES = {"episodes": 24, "frames_per_episode": 8, "episode_steps": 60, "size": 64, "workers": 1, "seed": 0}


def main() -> None:
    """Run all scenes, or those named; exit with 1 if one fails."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scenes", nargs="*", metavar="SCENE")
    chosen = parser.parse_args().scenes
    results = {}
    for scene in chosen or [*metaworld_tasks(), *OTHERS]:
        results[scene] = measure(scene)
        print(scene, results[scene], flush=True)
    failed = [scene for scene, result in results.items() if "failure" in result]
    if not chosen:
        write_json(
            Path("datasets/results/scenes.json"),
            {
                "command": "python -m tools.bench.scenes",
                "git_revision": git_revision(),
                "packages": package_versions(),
                "sizes": SIZES,
                "failed": failed,
                "scenes": results,
            },
        )
        write_tables(Path("datasets/README.md"), {"scenes": table(results)})
    sys.exit(1 if failed else 0)


def metaworld_tasks() -> list[str]:
    """Return the names of all Meta-World scenes."""
    from metaworld.env_dict import ENV_CLS_MAP

    return [METAWORLD + task for task in sorted(ENV_CLS_MAP)]


def measure(scene: str) -> dict[str, Any]:
    """Generate a dataset, check it, and return what it holds, or why it failed."""
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder) / "data"
        keys = [word for key, value in SIZES.items() for word in (f"--{key}", str(value))]
        for arguments in (["gen-dataset", "--scene", scene, "--out", str(out), *keys], ["check", str(out)]):
            done = subprocess.run(
                [Path(sys.executable).parent / "nerf-rl", *arguments], capture_output=True, text=True, check=False
            )
            if done.returncode:
                return {"failure": f"{arguments[0]}: {done.stderr.strip().splitlines()[-1]}"}
        manifest, summary = read_json(out / "manifest.json"), read_json(out / SUMMARY)
        return {
            "views": summary["views"],
            "seconds": summary["seconds"],
            "views_per_second": summary["views_per_second"],
            "classes": [label["name"] for label in manifest["classes"]],
            "privileged": [name.removesuffix("_x") for name in manifest["columns"]["privileged"] if name[-2:] == "_x"],
        }


def table(results: dict[str, dict[str, Any]]) -> str:
    """Return a row for each scene."""
    rows = [
        [
            f"`{scene}`",
            result.get("failure") or f"{result['views_per_second']:.0f}",
            ", ".join(result.get("classes", [])[1:]),
            ", ".join(result.get("privileged", [])),
        ]
        for scene, result in results.items()
    ]
    return markdown_table(["scene", "views/s", "classes beside the background", "positions recorded"], rows)


if __name__ == "__main__":
    main()
