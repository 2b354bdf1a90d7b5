"""Measure what reading costs: beside a pretraining step, and as datasets grow.

Renders two small datasets, trains a few steps on the first, and enlarges the second to sparse files of 1, 10 and 100 GB
(apparent size; unwritten images read as zeros and take no disk), each of which is opened in a process of its own.
Run from a checkout's root; a few minutes:

    .venv/bin/python -m tools.bench.reading --json datasets/results/reading.json
"""

import argparse
import json
import os
import re
import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import h5py
import numpy as np

from nerf_rl import cli
from nerf_rl.datasets.storage.frames import read_frame
from nerf_rl.datasets.storage.point_cloud import fuse_views
from nerf_rl.datasets.storage.reader import MultiViewDataset
from nerf_rl.datasets.storage.shards import MANIFEST, SHARDS
from nerf_rl.files.checksummed_json import write_checksummed
from nerf_rl.files.json_files import read_json, write_json
from nerf_rl.files.versions import git_revision, package_versions

SIZES_GB = (1, 10, 100)
IMAGES = ("rgb", "depth", "semantic")
STEPS, SKIPPED = 50, 10  # of pretraining; the first are slower
READS = 300


def main() -> None:
    """Measure, print and write."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--json", type=Path, help="result file to write")
    parser.add_argument("--scratch", type=Path, help="folder for the datasets; a temporary one by default")
    parser.add_argument("--probe", type=Path, help=argparse.SUPPRESS)
    parser.add_argument("--train", type=Path, nargs=2, help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    if arguments.probe:
        print(json.dumps(probe(arguments.probe)))
    elif arguments.train:
        print(json.dumps(training_cost(*arguments.train)))
    else:
        with tempfile.TemporaryDirectory(dir=arguments.scratch) as scratch:
            result = measure(Path(scratch))
        print(json.dumps(result, indent=2))
        if arguments.json:
            arguments.json.parent.mkdir(parents=True, exist_ok=True)
            write_json(arguments.json, result)


def measure(scratch: Path) -> dict:
    """Return all figures."""
    demo, small, seed = scratch / "demo", scratch / "small", 0
    recipes = {demo: ("demo", "60"), small: ("drawer-open", "20")}
    for folder, (recipe, episodes) in recipes.items():
        keys = ["--config", f"datasets/{recipe}.yaml", "--out", str(folder), "--episodes", episodes]
        assert cli.main(["gen-dataset", *keys, "--seed", str(seed)]) == 0
    training = run_here("--train", str(demo), str(scratch / "encoder"))
    by_size = {}
    for gigabytes in SIZES_GB:
        folder = scratch / f"{gigabytes}GB"
        enlarge(small, folder, gigabytes)
        by_size[f"{gigabytes} GB"] = {**run_here("--probe", str(folder)), "view_seconds": seconds_until_served(folder)}
    return {
        "loader": training,
        "by_apparent_size": by_size,
        "playback": playback(MultiViewDataset(small)),
        "seed": seed,
        "cpus": os.cpu_count(),
        "command": " ".join(["python -m tools.bench.reading", *sys.argv[1:]]),
        "git_revision": git_revision(),
        "packages": package_versions(),
    }


def run_here(*arguments: str) -> dict:
    """Run this script with other arguments in a new process; return what it printed last."""
    done = subprocess.run([sys.executable, "-m", "tools.bench.reading", *arguments], capture_output=True, text=True)
    if done.returncode:
        raise RuntimeError(done.stderr)
    return json.loads(done.stdout.strip().rpartition("\n")[2])


def training_cost(data: Path, out: Path) -> dict:
    """Pretrain for a few steps as `make demo` does; return what a step, its batch and the reading in it take [ms]."""
    from nerf_rl.pretrain.data.batches import RayBatches

    reading, batches, starts = [0.0], [], []
    read, make = MultiViewDataset.read, RayBatches.__getitem__

    def timed_read(self, name, frames=None):  # type: ignore[no-untyped-def]
        start = time.perf_counter()
        rows = read(self, name, frames)
        reading[0] += time.perf_counter() - start
        return rows

    def timed_batch(self, step):  # type: ignore[no-untyped-def]
        start, before = time.perf_counter(), reading[0]
        batch = make(self, step)
        starts.append(start)
        batches.append((time.perf_counter() - start, reading[0] - before))
        return batch

    MultiViewDataset.read, RayBatches.__getitem__ = timed_read, timed_batch  # type: ignore[method-assign]
    keys = ["--config", "pretrain/demo.yaml", "--data", str(data), "--out", str(out), "--steps", str(STEPS)]
    keys += ["--steps_per_epoch", str(STEPS), "--validation_frames", "2", "--probe_frames", "200"]
    assert cli.main(["pretrain", *keys]) == 0
    step = float(np.median(np.diff(starts[SKIPPED:STEPS])))
    batch, disk = (float(value) for value in np.median(batches[SKIPPED:STEPS], axis=0))
    return {
        "step_ms": round(1e3 * step, 2),
        "batch_ms": round(1e3 * batch, 2),
        "reading_ms": round(1e3 * disk, 2),
        "reading_share_of_step": round(disk / step, 4),
        "batch_share_of_step": round(batch / step, 4),
        "recipe": "pretrain/demo.yaml",
    }


def enlarge(template: Path, folder: Path, gigabytes: int) -> None:
    """Write a dataset of the template's layout and of an apparent size, with images left unwritten."""
    manifest = read_json(template / MANIFEST)
    (folder / SHARDS).mkdir(parents=True)
    with h5py.File(template / manifest["shards"][0]["file"]) as source:
        arrays: dict[str, h5py.Dataset] = {}
        source.visititems(lambda name, item: arrays.update({name: item}) if isinstance(item, h5py.Dataset) else None)
        frames = len(arrays["rgb"])
        size = sum(array.nbytes for array in arrays.values())
        count = max(1, round(gigabytes * 1e9 / size))
        entries = []
        for shard in range(count):
            path = folder / SHARDS / f"{shard:06d}.h5"
            with h5py.File(path, "w", libver=("v110", "v110")) as file:
                for name, array in arrays.items():
                    if name in IMAGES:
                        allocate(file, name, array)
                    elif name == "episode":
                        file[name] = array[:] + shard * (int(array[-1]) + 1)
                    else:
                        file[name] = array[:]
            entries.append({"file": f"{SHARDS}/{path.name}", "frames": frames, "sha256": f"{shard:064x}"})
    write_checksummed(folder / MANIFEST, {**manifest, "frames": count * frames, "shards": entries})


def allocate(file: h5py.File, name: str, like: h5py.Dataset) -> None:
    """Give an array its place in the file without writing it."""
    properties = h5py.h5p.create(h5py.h5p.DATASET_CREATE)
    properties.set_alloc_time(h5py.h5d.ALLOC_TIME_EARLY)
    properties.set_fill_time(h5py.h5d.FILL_TIME_NEVER)
    space = h5py.h5s.create_simple(like.shape)
    h5py.h5d.create(file.id, name.encode(), like.id.get_type(), space, properties)


def probe(folder: Path) -> dict:
    """Open a dataset and read frames at random; return times and memory."""
    before = resident_mb()
    start = time.perf_counter()
    dataset = MultiViewDataset(folder)
    opened = time.perf_counter()
    read_frame(dataset, len(dataset) - 1)
    first = time.perf_counter()
    scattered = np.random.default_rng(0).integers(len(dataset), size=READS)
    new_shards = time_reads(dataset, scattered)
    after = resident_mb()
    begin = time.perf_counter()
    dataset.split("train")
    split = time.perf_counter() - begin
    return {
        "frames": len(dataset),
        "shards": len(dataset.manifest["shards"]),
        "open_ms": round(1e3 * (opened - start), 2),
        "first_frame_ms": round(1e3 * (first - opened), 2),
        "random_frame_of_shards_not_seen_before_ms": round(1e3 * float(np.median(new_shards)), 3),
        "random_frame_ms": round(1e3 * float(np.median(time_reads(dataset, scattered[::-1]))), 3),
        "memory_for_it_mb": round(after - before, 1),
        "split_ms": round(1e3 * split, 1),
        "memory_after_all_shards_mb": round(resident_mb() - before, 1),
    }


def time_reads(dataset: MultiViewDataset, frames: np.ndarray) -> list[float]:
    """Read all views of some frames, one frame at a time; return the seconds of each."""
    times = []
    for frame in frames:
        begin = time.perf_counter()
        dataset.read("rgb", [frame])
        times.append(time.perf_counter() - begin)
    return times


def resident_mb() -> float:
    """Return the resident memory of this process now [MB]."""
    return int(Path("/proc/self/statm").read_text().split()[1]) * resource.getpagesize() / 2**20


def seconds_until_served(folder: Path) -> dict:
    """Run `nerf-rl view` until it prints its address; return the seconds in all and of them those of importing."""
    program = (
        "import time, sys; start = time.perf_counter(); import nerf_rl.viewer.view, nerf_rl.viewer.pages.dataset_view; "
    )
    program += "print(time.perf_counter() - start)"
    imports = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True).stdout
    start = time.perf_counter()
    command = [sys.executable, "-m", "nerf_rl.cli", "view", str(folder)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True) as process:
        assert process.stdout is not None
        printed = ""
        for line in process.stdout:
            printed += line
            if re.search(r"open http://", line):
                break
        seconds = time.perf_counter() - start
        process.terminate()
    if "open http://" not in printed:
        raise RuntimeError(printed)
    return {"all": round(seconds, 2), "importing": round(float(imports), 2)}


def playback(dataset: MultiViewDataset) -> dict:
    """Read frames in order and prepare what the viewer shows of them; return frames a second."""
    from nerf_rl.viewer.drawing.pictures import camera_strip, depth_limits

    limits, every = depth_limits(read_frame(dataset, 0)), range(len(dataset.class_names))
    times = []
    for index in range(min(60, len(dataset))):
        start = time.perf_counter()
        frame = read_frame(dataset, index)
        for view in range(len(dataset.camera_names)):
            camera_strip(frame, view, dataset.palette, limits)
        fuse_views(frame, "RGB", dataset.palette, limits, every, 2.5)
        times.append(time.perf_counter() - start)
    size = [len(dataset.camera_names), dataset.manifest["height"], dataset.manifest["width"]]
    return {"frames_per_second": round(1 / float(np.median(times)), 1), "views_height_width": size}


if __name__ == "__main__":
    main()
