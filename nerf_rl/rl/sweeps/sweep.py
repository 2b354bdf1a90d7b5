"""``nerf-rl train-rl --seeds``: a run for each seed, and what they are together."""

import contextlib
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import yaml

from nerf_rl.errors import FailureError, UserError
from nerf_rl.files.json_files import write_json
from nerf_rl.files.outputs import SUMMARY, prepare_output, write_provenance
from nerf_rl.rl.config import BASELINES, TrainRLConfig
from nerf_rl.rl.sweeps.figure import draw_sweep
from nerf_rl.rl.sweeps.progress import SweepProgress
from nerf_rl.rl.sweeps.runs import is_finished, is_training, read_run, run_folder
from nerf_rl.rl.sweeps.seed_list import parse_seeds
from nerf_rl.rl.sweeps.seed_process import Train, log_of
from nerf_rl.rl.sweeps.summary import summarise
from nerf_rl.rl.sweeps.table import aligned, describe_summary, seeds_table
from nerf_rl.rl.sweeps.workers import train_seeds_apart
from nerf_rl.rl.training.evaluation_results import describe_episodes

FIGURE = "learning_curves.png"


def train_seeds(train: Train, config: TrainRLConfig) -> dict[str, Any]:
    """Train a run for each of ``config.seeds`` into the folder ``config.out``; return the summary.

    The summary and the figure are written anew after each seed that is finished. One that fails stops no other.

    Args:
        train: from a run's configuration to its run folder; can be pickled.
        config: of the sweep.

    Raises:
        UserError: the folder is in use, or holds a sweep that cannot be gone on with so: with other keys, another
            encoder or seeds that are not asked for, or of a baseline whose runs were to end sooner.
        FailureError: some seeds failed; it names them.
    """
    out, seeds = Path(config.out), parse_seeds(config.seeds)
    resuming = config.resume and _can_resume(out, config, seeds)
    prepare_output(out, config.overwrite, config.resume, resuming, "train-rl")
    write_provenance(out, "train-rl", config)
    finished = [seed for seed in seeds if is_finished(run_folder(out, seed), config)]
    left = [seed for seed in seeds if seed not in finished]
    kept = f", {len(finished)} of them finished" if finished else ""
    print(f"train-rl writes {len(seeds)} seeds to {out}{kept}", flush=True)
    if (out / SUMMARY).is_file():  # of fewer steps or seeds, perhaps
        _write(out, config, finished)
    failed: dict[int, str] = {}
    with (
        SweepProgress(config, seeds, finished) as progress,
        contextlib.closing(train_seeds_apart(train, config, left, progress.say)) as ended,
    ):
        for end in ended:
            error = end.error or _missing(out, end.seed, config)
            progress.end(end.seed, not error)
            if error:
                failed[end.seed] = error
                log = log_of(out, end.seed)
                progress.say(f"seed {end.seed} failed, {error}; {log} ends with: {_last_line(log)}")
                continue
            finished.append(end.seed)
            run = _write(out, config, finished)["runs"][sorted(finished).index(end.seed)]
            progress.say(f"seed {end.seed}, {run['seconds']:,.0f} s: {describe_episodes(run['evaluations'][-1])}")
    summary = _write(out, config, finished)
    if finished:
        print(f"{aligned(*seeds_table(summary))}\n{describe_summary(summary)}; see {out / FIGURE}", flush=True)
    if failed:
        raise FailureError(_describe_failures(out, failed, len(seeds)))
    return summary


def require_one_run(folder: Path) -> None:
    """Raise UserError if a folder holds a sweep, which a single run would take for an interrupted one of its own."""
    seeds = _stored(folder).get("seeds") if is_training(folder) else None
    if seeds:
        raise UserError(f"{folder} holds runs of several seeds; resume them with --seeds {seeds}, or use another --out")


def _can_resume(out: Path, config: TrainRLConfig, seeds: list[int]) -> bool:
    """Tell whether the folder holds a sweep; raise UserError if it is another one."""
    if not is_training(out):
        return False
    from nerf_rl.rl.training.checkpoint import require_begun_so  # it takes PyTorch's time to import

    runs = {seed: run_folder(out, seed) for seed in seeds}
    require_begun_so(out, config, list(runs.values()))
    stored = _stored(out).get("seeds")
    if not stored:
        raise UserError(f"{out} holds a single run; use another --out for several seeds")
    left_out = sorted(set(parse_seeds(str(stored))) - set(seeds))
    if left_out:
        raise UserError(
            f"{out} was begun with --seeds {stored}, and {_names(left_out)} would be left out; resume with all of them "
            "or use another --out"
        )
    ended = [seed for seed, run in runs.items() if (run / SUMMARY).is_file() and not is_finished(run, config)]
    if config.algo in BASELINES and ended:
        raise UserError(
            f"--algo {config.algo} cannot go on with a run that has ended, as {_names(ended)} of {out} has; resume "
            "with the --env_steps and --episodes that it was begun with, or use another --out"
        )
    return True


def _stored(folder: Path) -> Mapping[str, Any]:
    """Return the keys that a folder was begun with; none if they are missing or damaged."""
    try:
        stored = yaml.safe_load((folder / "config.yaml").read_text(encoding="utf-8"))
    except (OSError, ValueError, RecursionError, yaml.YAMLError):
        return {}
    return stored if isinstance(stored, dict) else {}


def _write(out: Path, config: TrainRLConfig, finished: Iterable[int]) -> dict[str, Any]:
    """Write and return the summary of what is finished, and draw it."""
    summary = summarise([read_run(run_folder(out, seed)) for seed in finished])
    unfinished = sorted(set(parse_seeds(config.seeds)) - set(finished))
    summary = {"seeds": config.seeds, "unfinished": unfinished, **summary}
    if summary["runs"]:
        draw_sweep(out / FIGURE, summary, config.scene)
    else:
        (out / FIGURE).unlink(missing_ok=True)
    write_json(out / SUMMARY, summary)
    return summary


def _missing(out: Path, seed: int, config: TrainRLConfig) -> str:
    return "" if is_finished(run_folder(out, seed), config) else "it left no summary"


def _last_line(log: Path) -> str:
    """Return the last line of a log, which tells of an error; a process that was killed did not write of it."""
    lines = log.read_text(encoding="utf-8", errors="replace").split("\n") if log.is_file() else []
    return next((line.strip() for line in reversed(lines) if line.strip()), "nothing was said")


def _describe_failures(out: Path, failed: Mapping[int, str], seeds: int) -> str:
    errors = ", ".join(f"{seed} ({error})" for seed, error in sorted(failed.items()))
    logs = ", ".join(log_of(out, seed).name for seed in sorted(failed))
    return (
        f"{len(failed)} of {seeds} seeds failed: {errors}; what they said is in {log_of(out, 0).parent}: {logs}; "
        "the others are kept: go on with --resume true"
    )


def _names(seeds: list[int]) -> str:
    return f"seed{'s' * (len(seeds) != 1)} {', '.join(map(str, seeds))}"
