"""Datasets of imported images: they name a scene as all datasets do, but nothing simulates it."""

from nerf_rl.errors import UserError

IMPORTED = "imported/"
"""what the names of such scenes begin with"""


def require_simulator(name: str) -> None:
    """Raise UserError if a scene's name is that of imported images."""
    if name.startswith(IMPORTED):
        raise UserError(
            f"{name} is no scene but images that were imported: there is no simulator to render them again or to act in"
        )
