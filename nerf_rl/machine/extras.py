"""Optional dependencies: imported where they are used, with a sentence that names the extra to install."""

import importlib
from types import ModuleType

from nerf_rl.errors import UserError


def import_extra(module: str, extra: str, purpose: str) -> ModuleType:
    """Import a module that only the extra ``extra`` installs.

    Args:
        module: to import.
        extra: name of the extra in ``pyproject.toml``.
        purpose: what needs it, as the beginning of a sentence.

    Raises:
        UserError: it is not installed.
    """
    try:
        return importlib.import_module(module)
    except ModuleNotFoundError as error:
        if error.name is None or error.name.split(".")[0] != module.split(".")[0]:
            raise  # a dependency of the module is missing: another extra would not help
        raise UserError(
            f"{purpose} needs the extra '{extra}'; in a checkout of nerf-rl: pip install '.[{extra}]'"
        ) from error
