"""What is wrong with a source that somebody handed in, with the file that is to blame."""

from pathlib import Path

from nerf_rl.errors import UserError


class SourceError(UserError):
    """A file of a source is not what an import needs."""

    def __init__(self, path: Path, fault: str):
        super().__init__(f"{path} cannot be imported: {fault}")
