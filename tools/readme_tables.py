"""Tables in READMEs and pages, between markers that name them."""

import re
from collections.abc import Iterable, Mapping, Sequence


def markdown_table(header: Sequence[str], rows: Iterable[Sequence[object]]) -> str:
    """Return a table."""
    lines = [f"| {' | '.join(header)} |", f"|{'---|' * len(header)}"]
    return "\n".join(lines + [f"| {' | '.join(map(str, row))} |" for row in rows])


def replace_tables(text: str, tables: dict[str, str]) -> str:
    """Return a README's text with the tables between markers replaced; those without a marker are left out."""
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
