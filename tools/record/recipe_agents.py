"""Write the tables of agents by the recipe as it is, every finished seed of them, from the files that hold their runs.

Run from a checkout's root:

    .venv/bin/python -m tools.record.recipe_agents
"""

import itertools
import statistics
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any

from nerf_rl.rl.training.evaluation_results import SUCCESS
from tools.compare.agent_runs import ON_THE_WAY, read_entries
from tools.compare.agents import LATENTS, RESULTS, STATE, on_the_way
from tools.page_tables import AGENTS_PAGE, markdown_table, task_name, write_tables

SUMMARY_PAGES = (Path("README.md"), Path("rl/README.md"))
BEFORE = "strong self-imitation, curriculum, overtime, triple bonus and early echoes, 1.5 updates a step, little noise"
"""The recipe until retries had held actions of their own."""
HELD = f"{BEFORE}, held retries"
"""The recipe until an episode's end was worth no more than its last steps."""
WIDE = f"{HELD}, steady ends"
"""The recipe until networks had half of the paper's units."""
SMALL = f"{WIDE}, smaller networks"
"""The recipe until exploration came back after failures."""
ARM = f"{SMALL}, early renewal"
"""The recipe: a test has it that these are the keys of rl/drawer-open.yaml."""
NEW = ("early renewal", "smaller networks", "steady ends", "held retries")
"""what came into the recipe, the latest first"""
WITHOUT = {arm: ", ".join(NEW[:count]) for count, arm in enumerate((ARM, SMALL, WIDE, HELD, BEFORE))}
"""what recipes lack that is in the recipe now"""
SUMMARISED = (ARM, SMALL)
"""by which nothing differs but runs that would have failed so often in a row"""
WHOLE = 50_000
"""environment steps of a whole run"""
EYES = {LATENTS: "the latent", STATE: "the true state"}
"""what tables call what agents see"""


def main() -> None:
    """Write the whole table into the page of what was measured, and the recipe's own rows in short into the READMEs."""
    write_tables(AGENTS_PAGE, {"recipe-agents": table()})
    for page in SUMMARY_PAGES:
        write_tables(page, {"recipe-summary": summary()})


def read_arms(results: Path) -> list[dict[str, Any]]:
    """Return what all result files hold, an entry for each scene, eyes and arm."""
    return [entry for file in sorted(results.glob("*.json")) for entry in read_entries(file, "arms")]


def summary(results: Path = RESULTS) -> str:
    """Return a row for each task, eyes and of two recipes: success, and that of blind agents beside it."""
    entries = read_arms(results)
    rows = []
    scenes = dict.fromkeys(entry["scene"] for entry in entries)
    for scene, eyes, arm in itertools.product(scenes, EYES, SUMMARISED):
        if seen := list(runs_of(entries, scene, eyes, arm)):
            blind = list(runs_of(entries, scene, eyes, f"blind, {arm}"))
            told = [mean_and_worst(after(runs, steps)) for runs in (seen, blind) for steps in (ON_THE_WAY, WHOLE)]
            seeds = len({run["seed"] for run in seen})
            rows.append([task_name(scene), EYES[eyes], WITHOUT[arm], seeds, *told])
    header = ["task", "from", "without", "seeds", *columns()]
    return markdown_table(header, rows)


def mean_and_worst(successes: Sequence[float]) -> str:
    """Return the mean and the worst of several success rates in percent; one alone says so."""
    if not successes:
        return ""
    mean, worst = (f"{100 * rate:.0f}" for rate in (statistics.mean(successes), min(successes)))
    return f"{mean} ({worst})" if len(successes) > 1 else f"{mean} (one seed)"


def columns() -> list[str]:
    """Return the headers of success rates."""
    return [f"{who}after {steps:,}" for who in ("", "blind, ") for steps in (ON_THE_WAY, WHOLE)]


def table(results: Path = RESULTS) -> str:
    """Return a row for each task, eyes and recipe; runs that ended earlier count where they were evaluated."""
    entries = read_arms(results)
    rows = []
    for scene in dict.fromkeys(entry["scene"] for entry in entries):
        for eyes, arm in itertools.product(EYES, WITHOUT):
            seen, blind = (list(runs_of(entries, scene, eyes, name)) for name in (arm, f"blind, {arm}"))
            if seen:
                seeds = len({run["seed"] for run in seen})
                encoders = len({run.get("encoder") for run in seen}) if eyes == LATENTS else ""
                told = [after(seen, ON_THE_WAY), after(seen, WHOLE), after(blind, ON_THE_WAY), after(blind, WHOLE)]
                rows.append([task_name(scene), EYES[eyes], WITHOUT[arm], encoders, seeds, *map(rates, told)])
    return markdown_table(["task", "from", "without", "encoders", "seeds", *columns()], rows)


def runs_of(entries: Iterable[dict[str, Any]], scene: str, eyes: str, arm: str) -> Iterator[dict[str, Any]]:
    """Yield the runs of an arm, however long they were."""
    for entry in entries:
        if (entry["scene"], entry["eyes"], entry["arm"]) == (scene, eyes, arm):
            yield from entry["runs"]


def after(runs: Iterable[dict[str, Any]], steps: int) -> list[float]:
    """Return the success of each run that was evaluated after so many environment steps, the worst first."""
    last = [run["evaluations"][-1][SUCCESS] for run in runs if run["evaluations"][-1]["due"] == steps]
    earlier = [on_the_way(run) for run in runs] if steps == ON_THE_WAY else []
    return sorted([*last, *(rate for rate in earlier if rate is not None)])


def rates(successes: Iterable[float]) -> str:
    """Return success rates in percent, those that are the same together."""
    told = []
    for percent, same in itertools.groupby(f"{100 * success:.0f}" for success in successes):
        count = len(list(same))
        told.append(f"{count} times {percent}" if count > 1 else percent)
    return ", ".join(told)


if __name__ == "__main__":
    main()
