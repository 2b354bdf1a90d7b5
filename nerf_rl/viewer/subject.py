"""What a folder is: a dataset, an encoder or an agent, told by its files."""

from enum import Enum
from pathlib import Path

from nerf_rl.datasets.storage.shards import UNFINISHED
from nerf_rl.errors import MissingFileError
from nerf_rl.pretrain.model.encoder_file import DESCRIPTION
from nerf_rl.rl.agents.policy_file import POLICY_DESCRIPTION

_MARKS = {"dataset": "manifest.json", "encoder": DESCRIPTION, "agent": POLICY_DESCRIPTION}
_UNFINISHED = {"plan.json": "an unfinished dataset", "provenance.json": "an unfinished run"}


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
    if not path.exists():
        reason = "it does not exist"
    else:
        begun = [what for mark, what in _UNFINISHED.items() if (folder / mark).is_file()]
        reason = f"it is {begun[0]} (finish it with --resume true)" if begun else "its files are others"
    expected = ", ".join(f"{mark} of {'an' if kind[0] in 'ae' else 'a'} {kind}" for kind, mark in _MARKS.items())
    raise MissingFileError("something to view", path, reason, f"expected a folder with one of: {expected}")
