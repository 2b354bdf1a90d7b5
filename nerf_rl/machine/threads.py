"""How PyTorch's threads wait for each other."""

import os


def wait_passively() -> None:
    """Let OpenMP threads sleep while they wait for each other; call it before PyTorch is first imported.

    By default they spin. Once anything else runs on the same cores, a spinning thread keeps the one that it waits for
    from running, and a training step takes several times as long. A policy set by the user is kept.
    """
    os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")
