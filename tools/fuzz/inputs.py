"""Mutate the files that a user may hand in, let the real commands and loaders read them, and count what comes of it.

A mutated file must give a result or one sentence: never a traceback, a hang, memory without end or executed code. Run
from a checkout's root; it writes tools/results/fuzz.json:

    .venv/bin/python -m tools.fuzz.inputs --count 1000
"""

import argparse
import multiprocessing
import os
import resource
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

from nerf_rl.files.json_files import read_json, write_json
from nerf_rl.files.versions import git_revision, package_versions
from tools.fuzz.targets import EXECUTED, HANG, KINDS, MEMORY, OUTCOMES, TRACEBACK, Base, Targets

RESULTS = Path(__file__).parents[1] / "results" / "fuzz.json"
SECONDS, MEGABYTES = 60.0, 4096
_ADDRESS_SPACE = 64 << 30  # so that one huge allocation fails at once; libraries alone map some gigabytes
_KEPT = 3  # examples of each kind and bad outcome

DATASET = """
scene: metaworld/drawer-open-v3
episodes: 4
frames_per_episode: 3
episode_steps: 12
size: 24
rig:
  cameras: [{name: top, azimuth: 90, elevation: -70}, {name: left, azimuth: 20}]
  encoder: [left]
  test: [top]
  random: {count: 1}
validation_fraction: 0.25
episodes_per_shard: 2
workers: 1
seed: 3
"""
PRETRAINING = """
encoder: {latent: 8, patch: 4, channels: [8, 16], hidden: 16}
radiance_field: {width: 16, layers: 2, frequencies: 4, plane_size: 8, plane_features: 2}
sampling: {rendering_stratified: 6, rendering_importance: 4}
scenes_per_step: 2
rays_per_scene: 8
steps: 6
steps_per_epoch: 2
epochs_per_validation: 2
validation_frames: 2
probe_frames: 9
precision: "32"
threads: 1
"""
TRAINING = """
env_steps: 80
warmup_steps: 40
episode_steps: 20
learner: {batch_size: 8, bound_by_returns: true}
evaluation_every: 40
evaluation_episodes: 2
final_evaluation_episodes: 2
replay: {capacity: 200}
network: {hidden: [16, 16]}
"""


def main() -> None:
    """Mutate, count and print; write the file after each kind, in which those of before stay."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--count", type=int, default=1000, help="mutations of each kind")
    parser.add_argument("--seed", default="0", help="of the mutations")
    parser.add_argument("--first", type=int, default=0, help="number of the first mutation, to repeat one")
    parser.add_argument("--kinds", nargs="+", default=list(KINDS), choices=KINDS)
    parser.add_argument("--every", type=int, default=25, help="each so many-th mutation is read by slow commands, too")
    parser.add_argument("--base", type=Path, help="folder with the good files; made if it does not exist")
    parser.add_argument("--out", type=Path, default=RESULTS)
    arguments = parser.parse_args()
    numbers, bad = range(arguments.first, arguments.first + arguments.count), 0
    runs = read_json(arguments.out)["runs"] if arguments.out.exists() else {}
    with tempfile.TemporaryDirectory() as folder:
        base = make_base(arguments.base or Path(folder) / "base")
        for kind in arguments.kinds:
            started = time.monotonic()
            words = ["--kinds", kind, "--count", str(arguments.count), "--every", str(arguments.every)]
            table, examples = fuzz(base, [kind], numbers, arguments.seed, arguments.every, show=True)
            print(in_words(table), flush=True)
            runs[kind] = {
                "command": " ".join(["python -m tools.fuzz.inputs", *words]),
                "git_revision": git_revision(),
                "seed": arguments.seed,
                "seconds": round(time.monotonic() - started),
                **table[kind],
                **({"examples": examples} if examples else {}),
            }
            limits = {"seconds": SECONDS, "megabytes": MEGABYTES}
            write_json(arguments.out, {"packages": package_versions(), "limits": limits, "runs": runs})
            bad += sum(table[kind][outcome] for outcome in OUTCOMES[2:])
    sys.exit(1 if bad else 0)


def make_base(folder: Path) -> Base:
    """Return small good files in a folder, made by the commands unless they are there."""
    base = Base(folder / "dataset.yaml", folder / "dataset", folder / "encoder", folder / "agent")
    if base.agent.is_dir():
        return base
    folder.mkdir(parents=True, exist_ok=True)
    recipes = {"dataset": DATASET, "encoder": PRETRAINING, "agent": TRAINING}
    inputs = {"encoder": ["--data", str(base.dataset)], "agent": ["--encoder", str(base.encoder)]}
    for name, command in (("dataset", "gen-dataset"), ("encoder", "pretrain"), ("agent", "train-rl")):
        recipe = folder / f"{name}.yaml"
        recipe.write_text(recipes[name])
        words = ["--config", str(recipe), *inputs.get(name, []), "--out", str(folder / name)]
        subprocess.run([sys.executable, "-m", "nerf_rl.cli", command, *words], check=True, stdout=subprocess.DEVNULL)
    return base


def fuzz(
    base: Base, kinds: Sequence[str], numbers: range, seed: str, every: int, show: bool = False
) -> tuple[dict[str, dict[str, int]], list[dict[str, Any]]]:
    """Return how often each outcome came of each kind, and some examples of bad ones.

    Args:
        base: good files.
        kinds: of files to mutate.
        numbers: of the mutations; each is the same whenever it is made.
        seed: of the mutations.
        every: each so many-th mutation is read by whole commands that take seconds, too.
        show: print bad outcomes as they come.
    """
    table = {kind: dict.fromkeys(OUTCOMES, 0) for kind in kinds}
    examples: list[dict[str, Any]] = []
    jobs = [(kind, number) for kind in kinds for number in numbers]
    for kind, number, outcome, text, seconds in _outcomes(base, jobs, seed, every):
        table[kind][outcome] += 1
        if outcome in OUTCOMES[2:] and table[kind][outcome] <= _KEPT:
            examples.append({"kind": kind, "number": number, "outcome": outcome, "text": text[-3000:]})
        if show and (outcome in OUTCOMES[2:] or seconds > 20):
            print(f"{kind} {number}: {outcome} after {seconds:.1f} s: {text[-2500:]}", flush=True)
    return table, examples


def in_words(table: dict[str, dict[str, int]]) -> str:
    """Return the table as lines of text."""
    head = f"{'kind':<14}" + "".join(f"{outcome:>12}" for outcome in OUTCOMES)
    rows = [f"{kind:<14}" + "".join(f"{counts[name]:>12}" for name in OUTCOMES) for kind, counts in table.items()]
    return "\n".join([head, *rows])


def _outcomes(
    base: Base, jobs: Sequence[tuple[str, int]], seed: str, every: int
) -> Iterator[tuple[str, int, str, str, float]]:
    """Yield each job's outcome; a process that hangs, grows or dies is replaced by another."""
    context = multiprocessing.get_context("spawn")
    left = list(jobs)
    while left:
        ours, theirs = context.Pipe()
        with tempfile.TemporaryDirectory() as scratch:
            process = context.Process(target=_work, args=(base, Path(scratch), left, seed, every, theirs), daemon=False)
            process.start()
            theirs.close()
            try:
                while left:
                    outcome, text, seconds = _wait(ours, process)
                    if outcome in (HANG, MEMORY):
                        process.join()
                    yield *left.pop(0), outcome, text, seconds
                    if not process.is_alive():
                        break
            finally:
                process.kill()
                process.join()
                ours.close()


def _wait(connection: Connection, process: Any) -> tuple[str, str, float]:
    """Return the next outcome of a process, or what it was ended for."""
    begun = None
    while True:
        try:
            if connection.poll(0.05):
                message = connection.recv()
                if message[0] != "begun":
                    return message[0], message[1], time.monotonic() - (begun or time.monotonic())
                begun = time.monotonic()
        except (EOFError, OSError):
            process.join(5)
            return (
                TRACEBACK,
                f"the process died with {process.exitcode}",
                time.monotonic() - (begun or time.monotonic()),
            )
        if begun is None:
            continue
        seconds, megabytes = time.monotonic() - begun, _resident_megabytes(process.pid)
        if megabytes > MEGABYTES:
            process.kill()
            return MEMORY, f"{megabytes:.0f} MB", seconds
        if seconds > SECONDS:
            process.kill()
            return HANG, f"{seconds:.0f} s", seconds


def _resident_megabytes(pid: int) -> float:
    try:
        return int(Path(f"/proc/{pid}/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE") / 2**20
    except (OSError, IndexError):
        return 0.0


def _work(
    base: Base, scratch: Path, jobs: Sequence[tuple[str, int]], seed: str, every: int, connection: Connection
) -> None:
    """Mutate and read, in a process of its own."""
    resource.setrlimit(resource.RLIMIT_AS, (_ADDRESS_SPACE, _ADDRESS_SPACE))
    os.environ["OMP_NUM_THREADS"] = "1"
    targets = Targets(base, scratch, every)
    for kind, number in jobs:
        connection.send(("begun", ""))
        outcome, text = targets.mutate(kind, seed, number)
        connection.send((EXECUTED if targets.executed() else outcome, text))
    connection.close()


if __name__ == "__main__":
    main()
