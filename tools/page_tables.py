"""Tables in pages of the documentation, between markers that name them."""

import re
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path

from nerf_rl.files.atomic import write_text

ENCODERS_PAGE, AGENTS_PAGE, PAPER_PAGE = (Path(f"docs/results/{name}.md") for name in ("encoders", "agents", "paper"))
"""pages of what was measured"""


def markdown_table(header: Sequence[str], rows: Iterable[Sequence[object]]) -> str:
    """Return a table."""
    lines = [f"| {' | '.join(header)} |", f"|{'---|' * len(header)}"]
    return "\n".join(lines + [f"| {' | '.join(map(str, row))} |" for row in rows])


def write_tables(page: Path, tables: Mapping[str, str]) -> None:
    """Write tables into a page, each between its markers.

    Raises:
        ValueError: the page has no place for one.
    """
    text = page.read_text()
    if missing := [name for name in tables if f"<!-- table: {name} -->\n" not in text]:
        raise ValueError(f"{page} has no marker for the tables {missing}")
    write_text(page, replace_tables(text, tables))


def replace_tables(text: str, tables: Mapping[str, str]) -> str:
    """Return a page's text with the tables between markers replaced; those without a marker are left out."""
    for name, table in tables.items():
        pattern = rf"(<!-- table: {name} -->\n).*?(<!-- end -->)"
        text = re.sub(pattern, lambda match, table=table: f"{match[1]}{table}\n{match[2]}", text, flags=re.DOTALL)
    return text


def probe_errors(probe: Mapping[str, Mapping[str, float]]) -> str:
    """Return the RMSE [mm] of every column that a linear probe reads, but for goals."""
    return ", ".join(f"{name} {figure['rmse_mm']:.1f}" for name, figure in probe.items() if not name.startswith("goal"))


def task_name(scene: str) -> str:
    """Return what tables call a scene: a Meta-World task without what all of them share."""
    return scene.removeprefix("metaworld/").removesuffix("-v3")
