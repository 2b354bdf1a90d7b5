"""``nerf-rl check``: tell what is wrong with a dataset, and mend it if asked to."""

from pathlib import Path

from nerf_rl.datasets.upkeep.check_config import CheckConfig
from nerf_rl.datasets.upkeep.problems import Problem, find_problems
from nerf_rl.errors import FailureError


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
        remedy = f"nerf-rl check {folder} --repair true renders damaged shards anew"
        raise FailureError(f"{folder} is damaged: {_names(problems)}; {remedy}")
    from nerf_rl.datasets.upkeep.repair import repair  # it needs the simulator, a check does not

    repair(folder, problems, config.workers)
    left = _tell(folder, find_problems(folder))
    if left:
        raise FailureError(f"{folder}: what is wrong with {_names(left)} cannot be repaired")
    print(f"{folder}: repaired {_names(problems)}")


def _tell(folder: Path, problems: list[Problem]) -> list[Problem]:
    for problem in problems:
        print(f"{folder / problem.file}: {problem.fault}")
    return problems


def _names(problems: list[Problem]) -> str:
    return ", ".join(dict.fromkeys(problem.file for problem in problems))
