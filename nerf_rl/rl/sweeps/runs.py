"""What the runs of a sweep left in their folders."""

import csv
from collections.abc import Mapping
from pathlib import Path
from typing import Any, cast

import yaml

from nerf_rl.arguments.stored_keys import with_defaults
from nerf_rl.files.json_files import read_json
from nerf_rl.files.outputs import PROVENANCE, SUMMARY, command_of
from nerf_rl.files.structure import mapping, number, whole
from nerf_rl.rl.config import TrainRLConfig
from nerf_rl.rl.training.evaluation_results import DEMONSTRATIONS, DUE, EVALUATIONS, SUCCESS, due

GOOD = 0.95
"""success rate from which on a run counts as one that can do its task"""
_SUMMARY = mapping(
    {
        **dict.fromkeys(("env_steps", "episodes", "updates"), whole()),
        "seconds": number(0.0),
        "evaluations": EVALUATIONS,
    },
    others=True,
)
_KEYS = mapping(dict.fromkeys(("env_steps", "evaluation_every", "envs", "action_repeat"), whole(1)), others=True)
"""that tell when evaluations were due"""


def run_folder(out: Path, seed: int) -> Path:
    """Return the run folder of a seed."""
    return out / f"seed-{seed}"


def is_training(folder: Path) -> bool:
    """Tell whether train-rl began in a folder, a run or a sweep; keys of other commands have the same names."""
    return (folder / "config.yaml").is_file() and command_of(folder) in (None, "train-rl")  # None: it is damaged


def is_finished(run: Path, config: TrainRLConfig) -> bool:
    """Tell whether a run has had its environment steps, or its episodes; false where its files are unreadable."""
    try:
        summary = read_run(run)
    except (OSError, ValueError, RecursionError, yaml.YAMLError):
        return False
    return summary["env_steps"] >= config.env_steps or 0 < config.episodes <= summary["episodes"]


def read_run(run: Path) -> dict[str, Any]:
    """Return what a sweep's summary tells of a finished run.

    Each evaluation has the environment steps at which it was ``due`` beside those at which it came, which may be a few
    more; ``good`` tells when the first one with a success rate of 95 % or more came, None if there was none.

    Raises:
        OSError, ValueError, RecursionError, yaml.YAMLError: a file is missing or damaged.
    """
    summary, keys = read_json(run / SUMMARY), _keys(run)
    _SUMMARY(summary, "")
    provenance = read_json(run / PROVENANCE)
    mapping({"seed": whole()}, others=True)(provenance, "")
    evaluations = [{DUE: due(evaluation["env_steps"], keys), **evaluation} for evaluation in summary["evaluations"]]
    good = next((e["env_steps"] for e in evaluations if e.get(SUCCESS, 0.0) >= GOOD), None)
    return {
        "seed": provenance["seed"],
        "run": run.name,
        **{name: summary[name] for name in ("env_steps", "episodes", "updates", "seconds")},
        **({DEMONSTRATIONS: summary[DEMONSTRATIONS]} if DEMONSTRATIONS in summary else {}),
        "good": None if good is None else {"env_steps": good, "seconds": _seconds_at(run, good)},
        "evaluations": evaluations,
    }


def steps_so_far(run: Path) -> int:
    """Return the environment steps of a run that goes on, as far as ``metrics.csv`` tells."""
    steps = [steps for steps, _ in _times(run)]
    return max(steps, default=0)


def _keys(run: Path) -> Mapping[str, Any]:
    """Return the keys of a run, with defaults for those that it did not have yet."""
    keys = with_defaults(yaml.safe_load((run / "config.yaml").read_text(encoding="utf-8")), TrainRLConfig)
    _KEYS(keys, "")
    return cast(Mapping[str, Any], keys)


def _seconds_at(run: Path, env_steps: int) -> float | None:
    """Return the time that a run had taken when it came to an evaluation [s], if ``metrics.csv`` tells."""
    before = [seconds for steps, seconds in _times(run) if steps <= env_steps]
    return before[-1] if before else None


def _times(run: Path) -> list[tuple[int, float]]:
    """Return environment steps and seconds of each whole row of ``metrics.csv``."""
    try:
        with open(run / "metrics.csv", newline="", encoding="utf-8") as file:
            rows = list(csv.DictReader(line for line in file if line.endswith("\n")))
        return [(int(row["env_steps"]), float(row["seconds"])) for row in rows]
    except (OSError, ValueError, KeyError, TypeError, csv.Error):
        return []
