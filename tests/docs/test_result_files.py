"""Files of results that pages quote: small, and told what their runs were made with."""

from pathlib import Path
from typing import Any

import pytest

from tools.compare.agent_runs import put_runs, read_entries

ROOT = Path(__file__).parents[2]
RESULTS = [ROOT / room / "results" for room in ("datasets", "pretrain", "rl", "tools")]
FILES = sorted(file for folder in RESULTS for file in folder.rglob("*") if file.is_file())


@pytest.mark.parametrize("file", FILES, ids=lambda file: str(file.relative_to(ROOT)))
def test_a_result_file_is_small(file: Path) -> None:
    assert file.stat().st_size < 300_000


def test_runs_that_are_put_into_a_result_file_take_the_place_of_those_of_their_seeds(tmp_path: Path) -> None:
    result = tmp_path / "results.json"

    def put(arm: str, **torch_of_seed: str) -> list[dict[str, Any]]:
        runs = [{"seed": int(seed[1:]), "packages": {"torch": torch}} for seed, torch in torch_of_seed.items()]
        return put_runs(result, "arms", {"command": "make"}, {"arm": arm}, {"keys": []}, runs, lambda each: each["arm"])

    put("b", s1="2.11", s2="2.11")
    put("a", s1="2.15")
    entries = put("b", s2="2.15", s3="2.11")
    assert [(each["arm"], [run["seed"] for run in each["runs"]]) for each in entries] == [("a", [1]), ("b", [1, 2, 3])]
    assert [run["packages"]["torch"] for run in entries[1]["runs"]] == ["2.11", "2.15", "2.11"]
    assert read_entries(result, "arms") == entries
    assert result.read_text().count("2.11") == 1
    assert sum('"seed"' in line for line in result.read_text().splitlines()) == 4, "a line for each run"
