"""Result files of many runs: a line for each, so that they stay small and changes of them can be read."""

import json
import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from nerf_rl.files.atomic import write_text
from nerf_rl.files.json_files import json_text


class Lines:
    """Stands in the place of runs while the file around them is put into words."""

    def __init__(self) -> None:
        self._lines: list[str] = []

    def place(self, run: dict[str, Any]) -> str:
        """Return what holds a run's place."""
        self._lines.append(json.dumps(run, allow_nan=False))
        return f"run {len(self._lines) - 1}"

    def write(self, result: Path, content: dict[str, Any]) -> None:
        """Write what was put into words, each run in its place."""
        text = re.sub(r'"run (\d+)"', lambda place: self._lines[int(place[1])], json_text(content))
        write_text(result, text)


def write_runs(result: Path, head: dict[str, Any], runs: Sequence[dict[str, Any]]) -> None:
    """Write runs after what is told of all of them."""
    lines = Lines()
    lines.write(result, {**head, "runs": [lines.place(run) for run in runs]})
