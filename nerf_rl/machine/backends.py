"""Where worker processes run, by name; :mod:`nerf_rl.machine.worker_pools` starts them."""

from nerf_rl.errors import UnknownNameError

LOCAL, RAY = "local", "ray"
BACKENDS = (LOCAL, RAY)
"""processes of this machine, or of a Ray cluster"""
_EARLIER = ("loky",)  # what recipes and runs of earlier versions call local


def check_backend(name: str) -> None:
    """Raise UnknownNameError if there is no such backend."""
    if name not in (*BACKENDS, *_EARLIER):
        raise UnknownNameError("backend", name, BACKENDS)
