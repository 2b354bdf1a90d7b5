"""Kill dataset generations at random moments, flip bytes, fill the disk, and count what is not made good again.

Run from a checkout's root; it writes datasets/results/crash_safety.json (half an hour or more on two cores):

    .venv/bin/python -m tools.bench.crash_safety
"""

import argparse
import contextlib
import io
import json
import os
import random
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

import h5py

from nerf_rl import cli
from nerf_rl.datasets.storage.shards import MANIFEST, SHARDS
from nerf_rl.files.json_files import write_json
from nerf_rl.files.outputs import PROVENANCE
from nerf_rl.files.versions import git_revision, package_versions

KEYS = {"episodes": 16, "frames_per_episode": 6, "episode_steps": 20, "size": 16, "episodes_per_shard": 2, "workers": 2}
SHARD_COUNT = 8
SIGNED = (MANIFEST, "plan.json")
BALLAST = "ballast"


def main() -> None:
    """Run what is asked for and record it."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--kills", type=int, default=200)
    parser.add_argument("--flips", type=int, default=1000)
    parser.add_argument("--kills-only", action="store_true", help="leave flips, disk and memory out")
    parser.add_argument("--seed", type=int, default=0, help="of the moments and bytes")
    parser.add_argument("--out", type=Path, default=Path("datasets/results/crash_safety.json"))
    options = parser.parse_args()
    rng, start, revision = random.Random(options.seed), time.monotonic(), git_revision()
    with tempfile.TemporaryDirectory() as scratch:
        reference = Path(scratch, "reference")
        rendering, undisturbed = time_reference(reference)
        result = {
            "command": " ".join(["python -m tools.bench.crash_safety", *sys.argv[1:]]),
            "git_revision": revision,
            "python": sys.version.split()[0],
            "packages": package_versions(),
            "keys": KEYS,
            "undisturbed_seconds": round(undisturbed, 1),
            "renderer": json.loads((reference / MANIFEST).read_text())["renderer"],
        }
        if not options.kills_only:
            result |= {
                "worker_peak_rss_mb": full_size_memory(Path(scratch, "memory")),
                "disk_full": fill_disk(reference, Path(scratch, "full")),
                "byte_flips": flip_bytes(reference, options.flips, rng),
            }
        for kills in kill(reference, Path(scratch, "killed"), options.kills, (rendering, undisturbed), rng):
            result |= {"kills": kills, "seconds": round(time.monotonic() - start, 1)}
            write_json(options.out, result)


def time_reference(folder: Path) -> tuple[float, float]:
    """Make the dataset to compare with; return how long it took after the first file of a shard, and in all [s]."""
    begun = time.monotonic()
    process = subprocess.Popen(command(folder), stdout=subprocess.DEVNULL)
    wait_for_shards(folder, process)
    first = time.monotonic()
    assert process.wait() == 0
    return time.monotonic() - first, time.monotonic() - begun


def wait_for_shards(folder: Path, process: subprocess.Popen) -> None:
    """Wait until a generation has begun to write shards."""
    while process.poll() is None and not ((folder / SHARDS).is_dir() and any((folder / SHARDS).iterdir())):
        time.sleep(0.001)


def command(out: Path, *arguments: str) -> list[str]:
    """Return the command line of a small generation."""
    keys = [word for key, value in KEYS.items() for word in (f"--{key}", str(value))]
    return [sys.executable, "-m", "nerf_rl.cli", "gen-dataset", "--out", str(out), *keys, *arguments]


def run(out: Path, *arguments: str) -> None:
    """Run a small generation to its end."""
    subprocess.run(command(out, *arguments), check=True, stdout=subprocess.DEVNULL)


def content(folder: Path) -> dict[str, bytes]:
    """Return the files that the configuration decides, and all others beside the shards."""
    paths = [*(folder / SHARDS).iterdir(), *(folder / name for name in SIGNED)]
    return {str(path.relative_to(folder)): path.read_bytes() for path in paths}


def kill(
    reference: Path, folder: Path, kills: int, durations: tuple[float, float], rng: random.Random
) -> Iterator[dict]:
    """Kill a generation by two workers at a random moment, resume it with one, and compare; again and again.

    Half of the moments are uniform in the time that a run takes, half in the shorter time in which it writes shards.

    Args:
        reference: an undisturbed dataset.
        folder: to write to.
        kills: how many.
        durations: of writing shards and of a whole run [s].
        rng: of the moments.

    Yields:
        Counts so far.
    """
    expected, moments, identical, unreadable = content(reference), Counter(), 0, 0
    for number in range(kills):
        process = subprocess.Popen(
            command(folder), stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, start_new_session=True
        )
        while_writing = number % 2 == 0
        if while_writing:
            wait_for_shards(folder, process)
        time.sleep(rng.uniform(0.0, durations[0] if while_writing else durations[1]))
        with contextlib.suppress(ProcessLookupError):
            os.killpg(process.pid, signal.SIGKILL)
        process.wait()
        moments[stage(folder)] += 1
        unreadable += sum(not readable(path) for path in folder.rglob("*") if is_finished_file(path))
        run(folder, "--resume", "true", "--workers", "1")
        identical += content(folder) == expected
        shutil.rmtree(folder)
        print(f"{number + 1} kills: {identical} byte-identical, {unreadable} unreadable files", flush=True)
        yield {
            "kills": number + 1,
            "byte_identical": identical,
            "unreadable_files": unreadable,
            "moments": dict(moments),
        }


def stage(folder: Path) -> str:
    """Tell how far a generation had come."""
    if not (folder / PROVENANCE).exists():
        return "before the first file was whole"
    shards = sum(path.suffix == ".h5" for path in (folder / SHARDS).glob("[0-9]*"))
    if (folder / MANIFEST).exists():
        return "after the manifest"
    return "before the first shard" if shards == 0 else "among shards" if shards < SHARD_COUNT else "after the last"


def is_finished_file(path: Path) -> bool:
    """Tell whether a path is a file with a final name."""
    return path.is_file() and not path.name.startswith(".")


def readable(path: Path) -> bool:
    """Tell whether a file can be read whole."""
    try:
        if path.suffix == ".json":
            json.loads(path.read_text())
        elif path.suffix == ".h5":
            with h5py.File(path) as file:
                return all(len(file[name]) == 12 for name in ("rgb", "depth", "reward"))
        return True
    except (OSError, ValueError, KeyError):
        return False


def flip_bytes(folder: Path, flips: int, rng: random.Random) -> dict:
    """Change one byte at a time, in any shard, the manifest or the plan, and ask ``nerf-rl check`` for the file."""
    files = sorted(content(folder))
    found = Counter()
    for _ in range(flips):
        name = rng.choice(files)
        path = folder / name
        before = path.read_bytes()
        place, mask = rng.randrange(len(before)), rng.randrange(1, 256)
        path.write_bytes(before[:place] + bytes([before[place] ^ mask]) + before[place + 1 :])
        code, shown = quietly(["check", str(folder)])
        found["found and named"] += code == 1 and f"{path}: " in shown
        path.write_bytes(before)
    undisturbed, _ = quietly(["check", str(folder)])
    return {"flips": flips, "found_and_named": found["found and named"], "check_of_the_whole_exits_with": undisturbed}


def quietly(arguments: list[str]) -> tuple[int, str]:
    """Run a command in this process; return its exit code and what it printed."""
    shown = io.StringIO()
    with contextlib.redirect_stdout(shown), contextlib.redirect_stderr(shown):
        code = cli.main(arguments)
    return code, shown.getvalue()


def fill_disk(reference: Path, mount: Path) -> dict:
    """Let the disk become full while shards are written, on a file system of its own, then make room and resume."""
    if os.geteuid() != 0:
        return {"skipped": "mounting a small file system needs root"}
    expected = content(reference)
    size = sum(map(len, expected.values()))
    mount.mkdir()
    subprocess.run(["mount", "-t", "tmpfs", "-o", f"size={4 * size + 2**20}", "tmpfs", str(mount)], check=True)
    try:
        folder, ballast = mount / "data", mount / BALLAST
        process = subprocess.Popen(command(folder), stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True)
        while not (folder / SHARDS).is_dir() and process.poll() is None:
            time.sleep(0.001)
        ballast.write_bytes(bytes(shutil.disk_usage(mount).free - size // 2))
        message = process.communicate()[1].strip().splitlines()
        kept = len(list((folder / SHARDS).glob("[0-9]*.h5")))
        ballast.unlink()
        run(folder, "--resume", "true")
        return {
            "exit_code": process.returncode,
            "message": [line.replace(str(mount), "DISK") for line in message],
            "shards_kept": kept,
            "byte_identical_after_resume": content(folder) == expected,
        }
    finally:
        subprocess.run(["umount", "--lazy", str(mount)], check=True)


def full_size_memory(folder: Path) -> float:
    """Return the most memory that a worker takes for the recipe of full size [MB]."""
    keys = ["--config", "datasets/drawer-open.yaml", "--episodes", "40", "--out", str(folder)]
    subprocess.run([sys.executable, "-m", "nerf_rl.cli", "gen-dataset", *keys], check=True, stdout=subprocess.DEVNULL)
    return json.loads((folder / "summary.json").read_text())["worker_peak_rss_mb"]


if __name__ == "__main__":
    main()
