"""Which code a result was made by."""

import importlib.metadata
import subprocess
from pathlib import Path

_RECORDED_PACKAGES = ("torch", "torchrl", "lightning", "mujoco", "metaworld", "gymnasium", "h5py", "numpy", "optuna")


def git_revision() -> str | None:
    """Return the revision of the checkout this package runs from, with ``-dirty`` for uncommitted changes, if any."""
    try:
        described = subprocess.run(
            ["git", "describe", "--always", "--dirty", "--abbrev=40", "--exclude=*"],
            cwd=Path(__file__).parent,
            capture_output=True,
            text=True,
            timeout=5,
        )
    except (OSError, subprocess.TimeoutExpired):
        return None
    return described.stdout.strip() if described.returncode == 0 else None


def package_versions() -> dict[str, str]:
    """Return the versions of the packages that results depend on."""
    versions = {}
    for name in _RECORDED_PACKAGES:
        try:
            versions[name] = importlib.metadata.version(name)
        except importlib.metadata.PackageNotFoundError:
            continue
    return versions
