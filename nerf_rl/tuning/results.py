"""What a search leaves: trials.csv, best.yaml, history.png and summary.json."""

import csv
import io
from pathlib import Path
from typing import Any

import numpy as np
import optuna
import yaml
from optuna.study import StudyDirection
from optuna.trial import FrozenTrial, TrialState

from nerf_rl.files.atomic import atomic_write, write_text
from nerf_rl.files.json_files import write_json
from nerf_rl.files.outputs import SUMMARY, plain
from nerf_rl.tuning.config import TuneConfig
from nerf_rl.tuning.objective import ENV_STEPS
from nerf_rl.tuning.recipe import trial_config

TRIALS, BEST, HISTORY, RECIPE = "trials.csv", "best.yaml", "history.png", "recipe.yaml"


def write_results(study: optuna.Study, config: TuneConfig, seconds: float) -> dict[str, Any]:
    """Write a finished search's files into its output folder, the summary last; return the summary.

    Args:
        study: as it is now.
        config: of the search.
        seconds: wall time of this session [s].
    """
    out, trials = Path(config.out), study.get_trials(deepcopy=False)
    write_text(out / TRIALS, trials_table(trials))
    best = study.best_trial if any(trial.state == TrialState.COMPLETE for trial in trials) else None
    if best is not None:
        recipe = plain(trial_config(config, best.params, config.out))
        kept = {key: value for key, value in recipe.items() if key not in ("out", "resume", "overwrite")}
        head = f"# Trial {best.number} of a search: {config.fitness} {best.value:g}.\n"
        write_text(out / BEST, head + yaml.safe_dump(kept, sort_keys=False))
        draw_history(out / HISTORY, trials, config.fitness, study.direction)
    states = ("complete", "pruned", "failed")
    counts = [sum(trial.state == state for trial in trials) for state in _ENDED]
    summary = {
        "best_value": best.value if best is not None else None,
        "best_trial": best.number if best is not None else None,
        "best_params": best.params if best is not None else None,
        "trials": dict(zip(states, counts, strict=True)),
        "env_steps": sum(map(env_steps, trials)),
        "trial_seconds": round(sum(map(_seconds, trials)), 1),
        "seconds": round(seconds, 1),
    }
    write_json(out / SUMMARY, summary)
    return summary


def trials_table(trials: list[FrozenTrial]) -> str:
    """Return a row of CSV for each trial."""
    names = sorted({name for trial in trials for name in trial.params})
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(["number", "state", "value", "seconds", ENV_STEPS, *names])
    for trial in trials:
        value = "" if trial.state != TrialState.COMPLETE else trial.value
        row = [trial.number, trial.state.name.lower(), value, f"{_seconds(trial):.1f}", env_steps(trial)]
        writer.writerow([*row, *(trial.params.get(name, "") for name in names)])
    return text.getvalue()


def draw_history(path: Path, trials: list[FrozenTrial], fitness: str, direction: StudyDirection) -> None:
    """Draw each trial's value, and the best so far, over the environment steps spent by then."""
    from matplotlib.figure import Figure  # takes half a second to import

    ended = [trial for trial in trials if trial.datetime_complete is not None]
    ended.sort(key=lambda trial: trial.datetime_complete)  # type: ignore[arg-type,return-value]
    steps = np.cumsum([env_steps(trial) for trial in ended])
    values = np.array([trial.value if trial.state == TrialState.COMPLETE else np.nan for trial in ended], float)
    best = np.fmin.accumulate(values) if direction == StudyDirection.MINIMIZE else np.fmax.accumulate(values)
    figure = Figure(figsize=(6, 3.5), layout="constrained")
    axes = figure.subplots()
    axes.plot(steps, values, "o", markersize=3, alpha=0.5, label="trial")
    axes.step(steps, best, where="post", color="tab:red", label="best so far")
    axes.set(xlabel="environment steps of all trials", ylabel=fitness.replace("_", " "))
    axes.legend()
    with atomic_write(path) as aside:
        figure.savefig(aside, format="png", dpi=120)


def env_steps(trial: FrozenTrial) -> int:
    """Return the environment steps that a trial has spent, as far as its evaluations tell."""
    return int(trial.user_attrs.get(ENV_STEPS, 0))


_ENDED = (TrialState.COMPLETE, TrialState.PRUNED, TrialState.FAIL)


def _seconds(trial: FrozenTrial) -> float:
    return trial.duration.total_seconds() if trial.duration is not None else 0.0
