"""Put two rounds of the tasks beside each other, on fewer and on more episodes: a page's table.

Run from a checkout's root:

    .venv/bin/python -m tools.record.episodes

Both rounds are of `tools.compare.tasks`, with the same seeds, minutes and threads on the same kind of processor, and of
encoders without landmarks; the revisions in the files have the recipes that they are of.
"""

from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

from nerf_rl.files.json_files import read_json
from tools.compare.frames import both
from tools.page_tables import markdown_table, write_tables

FEWER, MORE = Path("datasets/results/fewer_episodes.json"), Path("pretrain/results/tasks_without_landmarks.json")
PAGE = Path("docs/choosing.md")


def main() -> None:
    """Write the page's table."""
    rounds = [{(row["task"], row["seed"]): row for row in read_json(file)["runs"]} for file in (FEWER, MORE)]
    write_tables(PAGE, {"choosing-episodes": table(*rounds)})


def table(fewer: Mapping[tuple[str, int], Any], more: Mapping[tuple[str, int], Any]) -> str:
    """Return a row for each task and seed that both rounds have."""
    header = ["task", "seed"]
    header += [f"{what}, {which} [mm]" for what in ("hand", "objects") for which in ("fewer", "more")]
    header += ["lowest IoU, fewer", "more"]
    lines = []
    for key in sorted(fewer.keys() & more.keys()):
        rows = fewer[key], more[key]
        hands, objects = zip(*(both(drawn(row["probe"])) for row in rows), strict=True)
        lines.append([*key, *hands, *objects, *(lowest(row["class_iou"].items()) for row in rows)])
    return markdown_table(header, lines)


def drawn(probe: Mapping[str, Mapping[str, float]]) -> dict[str, Mapping[str, float]]:
    """Return the figures of all columns but goals, of which some are not drawn."""
    return {name: figures for name, figures in probe.items() if not name.startswith("goal_")}


def lowest(classes: Iterable[tuple[str, float | None]]) -> str:
    """Return the class with the lowest IoU."""
    iou, name = min((iou, name) for name, iou in classes if iou is not None)
    return f"{name} {iou:.2f}"


if __name__ == "__main__":
    main()
