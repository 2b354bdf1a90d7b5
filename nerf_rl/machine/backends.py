"""Where worker processes run, by name; :mod:`nerf_rl.machine.worker_pools` starts them."""

from nerf_rl.errors import UnknownNameError, UserError

BACKENDS = ("loky", "ray")
"""processes of this machine, or of a Ray cluster"""


def check_backend(name: str, workers: int | None) -> None:
    """Raise UserError if there is no such backend, or if it cannot have so few workers; None lets it choose."""
    if name not in BACKENDS:
        raise UnknownNameError("backend", name, BACKENDS)
    if name == "ray" and workers == 1:
        raise UserError("--backend ray needs at least 2 --workers; use --backend loky for one")
