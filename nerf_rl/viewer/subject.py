"""What a folder is: a dataset, an encoder or an agent, told by its files."""

import shlex
from enum import Enum
from pathlib import Path

from nerf_rl.datasets.storage.shards import PARTS, UNFINISHED
from nerf_rl.errors import MissingFileError
from nerf_rl.files.outputs import PROVENANCE, SUMMARY, command_of
from nerf_rl.pretrain.model.encoder_file import DESCRIPTION
from nerf_rl.rl.agents.policy_file import POLICY_DESCRIPTION, told_of_seeds

_MARKS = {"dataset": "manifest.json", "encoder": DESCRIPTION, "agent": POLICY_DESCRIPTION}
_PLAN = "plan.json"
_MOST_NAMED = 5
RESUMED = ("gen-dataset", "import", "merge", "pretrain", "train-rl", "tune")
"""commands whose runs go on by ``--resume true``"""


class Subject(Enum):
    """What there is to look at."""

    DATASET = "dataset"
    ENCODER = "encoder"
    AGENT = "agent"


def find_subject(path: Path) -> Subject:
    """Return what the path is; a file inside a run folder stands for the run.

    Raises:
        MissingFileError: it is none of them; the message says what was expected.
    """
    folder = path if path.is_dir() else path.parent
    for kind, mark in _MARKS.items():
        if (folder / mark).is_file() and (path.is_dir() or path.is_file()):
            return Subject(kind)
    if path.is_dir() and (path / UNFINISHED).is_file():
        return Subject.DATASET
    if path.suffix == ".ckpt" and path.is_file() and (folder.parent / DESCRIPTION).is_file():
        return Subject.ENCODER
    reason = _told_by_other_files(path, folder) if path.exists() else "it does not exist"
    expected = ", ".join(f"{mark} of {'an' if kind[0] in 'ae' else 'a'} {kind}" for kind, mark in _MARKS.items())
    raise MissingFileError("something to view", path, reason, f"expected a folder with one of: {expected}")


def _told_by_other_files(path: Path, folder: Path) -> str:
    """Return what a path is, in a folder in which there is nothing to view."""
    if (folder / PARTS).is_dir():
        return f"it holds parts of a dataset (put them together with: nerf-rl merge {shlex.quote(str(folder))})"
    if (folder / _PLAN).is_file():
        return "it is an unfinished dataset (finish it with --resume true)"
    if not (folder / PROVENANCE).is_file():
        return _told_by_contents(path) if path.is_dir() else "its files are others"
    if told := told_of_seeds(folder):
        return "; ".join(told)
    command = command_of(folder)
    if command is None:
        return f"its {PROVENANCE} is damaged"
    if (folder / SUMMARY).is_file():
        return f"it is a finished run of {command}"
    return f"it is an unfinished run of {command}" + " (finish it with --resume true)" * (command in RESUMED)


def _told_by_contents(folder: Path) -> str:
    """Return what a folder is that no command of ours wrote."""
    contents = sorted(folder.iterdir())
    inside = [entry for entry in contents if any((entry / mark).is_file() for mark in _MARKS.values())]
    if inside:
        names = ", ".join(entry.name for entry in inside[:_MOST_NAMED]) + ", ..." * (len(inside) > _MOST_NAMED)
        return f"it holds {names}; give the folder of one, such as {inside[0]}"
    return "its files are others" if contents else "it is empty"
