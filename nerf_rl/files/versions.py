"""Which code a result was made by, and on what processor."""

import functools
import importlib.metadata
import platform
import subprocess
from pathlib import Path

from nerf_rl.machine.cores import usable_cores

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
    versions = {name: _version(name) for name in _RECORDED_PACKAGES}
    return {name: version for name, version in versions.items() if version is not None}


@functools.cache  # what is imported stays as it is, and reading a package's metadata takes milliseconds
def _version(package: str) -> str | None:
    try:
        return importlib.metadata.version(package)
    except importlib.metadata.PackageNotFoundError:
        return None


def processor(cpuinfo: Path = Path("/proc/cpuinfo")) -> str:
    """Return the processor's name, how many cores this process may use, and its instructions for bfloat16.

    Args:
        cpuinfo: what Linux tells of it; elsewhere, and on Arm, its name is its architecture's.
    """
    text = cpuinfo.read_text() if cpuinfo.exists() else ""
    name = text.partition("model name")[2].partition(":")[2].partition("\n")[0].strip() or platform.machine()
    cores = usable_cores()
    flags = [flag for flag in ("avx512_bf16", "amx_bf16") if f" {flag}" in text]
    return f"{name}, {cores} cores ({', '.join(flags) or 'without bfloat16'})"
