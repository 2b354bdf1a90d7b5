"""``nerf-rl check``: tell what is wrong with a dataset, and mend it if asked to."""

import contextlib
import shlex
from pathlib import Path

from nerf_rl.datasets.storage.plan import PLAN
from nerf_rl.datasets.storage.shards import MANIFEST
from nerf_rl.datasets.storage.stored_manifest import IMPORTED_FROM
from nerf_rl.datasets.upkeep.config import CheckConfig
from nerf_rl.datasets.upkeep.problems import IMPORT_AGAIN, Problem, find_problems
from nerf_rl.errors import FailureError
from nerf_rl.files.json_files import read_json


def check(config: CheckConfig) -> None:
    """Check a dataset, print what is wrong with it, and mend that if asked to.

    Raises:
        MissingFileError: the folder holds no finished dataset.
        FailureError: something is wrong with the dataset, or still is after the repair.
    """
    folder = Path(config.folder)
    problems = _tell(folder, find_problems(folder))
    if not problems:
        print(f"{folder}: whole and unchanged")
        return
    if not config.repair:
        rendered = f"nerf-rl check {shlex.quote(str(folder))} --repair true renders damaged shards anew"
        remedy = IMPORT_AGAIN if _is_imported(folder) else rendered
        raise FailureError(f"{folder} is damaged: {_names(problems)}; {remedy}")
    from nerf_rl.datasets.upkeep.repair import repair  # it needs the simulator, a check does not

    repair(folder, problems, config.workers)
    left = _tell(folder, find_problems(folder))
    if left:
        raise FailureError(f"{folder}: what is wrong with {_names(left)} cannot be repaired")
    print(f"{folder}: repaired {_names(problems)}")


def _is_imported(folder: Path) -> bool:
    """Tell whether a dataset's pictures were imported, by its plan or, if that is damaged, by its manifest."""
    for file, key in ((PLAN, None), (MANIFEST, "config")):
        with contextlib.suppress(OSError, ValueError, KeyError, TypeError):
            content = read_json(folder / file)
            return IMPORTED_FROM in (content if key is None else content[key])
    return False


def _tell(folder: Path, problems: list[Problem]) -> list[Problem]:
    for problem in problems:
        print(f"{folder / problem.file}: {problem.fault}")
    return problems


def _names(problems: list[Problem]) -> str:
    return ", ".join(dict.fromkeys(problem.file for problem in problems))
