"""Mistakes and failures that the user can mend, each told in one sentence that says how."""

from collections.abc import Iterable
from difflib import get_close_matches
from pathlib import Path

BEGIN_ANEW = "begin the run anew with --overwrite true, or use another --out"
"""what to do about a checkpoint that a run cannot go on from"""


class UserError(Exception):
    """Base class: the command line prints the message without a traceback and exits with 2."""


class FailureError(Exception):
    """Work that could not be done: the command line prints the message without a traceback and exits with 1."""


class DivergedError(FailureError):
    """A run whose evaluation brought an action or a return that is no number, or whose weights are none.

    Args:
        env_steps: that the run took until then.
        what: is not a number.
    """

    def __init__(self, env_steps: int, what: str):
        self.env_steps = env_steps
        super().__init__(
            f"the run diverged: after {env_steps} env steps {what} is not a number; lower the learning rates, or see "
            "how large the environment's observations and rewards are"
        )


class UnknownNameError(UserError):
    """A name that is not among those available."""

    def __init__(self, kind: str, name: str, available: Iterable[str]):
        names = sorted(available)
        close = get_close_matches(name, names, n=3, cutoff=0.5)
        hint = f" (did you mean {' or '.join(close)}?)" if close else ""
        super().__init__(f"unknown {kind} '{name}'{hint}; available: {', '.join(names) or 'none'}")


class MissingFileError(UserError):
    """An input that does not exist or is not what the command expects."""

    def __init__(self, kind: str, path: Path | str, reason: str, remedy: str):
        super().__init__(f"{path} is not {kind}: {reason}; {remedy}")


class OutputExistsError(UserError):
    """The output already holds something that would be lost."""

    def __init__(self, path: Path, choices: str):
        there = f"folder {path} already exists and is not empty" if path.is_dir() else f"file {path} already exists"
        super().__init__(f"output {there}; {choices}")


class RigMismatchError(UserError):
    """The cameras at hand are not those that an encoder was trained on."""

    def __init__(self, difference: str):
        super().__init__(f"the encoder was trained on another camera rig: {difference}")
