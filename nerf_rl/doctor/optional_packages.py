"""What the doctor says of the optional packages, and why one cannot be had on this machine."""

import contextlib
import importlib.metadata
import importlib.util
import platform
import sys
from collections.abc import Iterable

from nerf_rl.doctor.finding import Finding, shortened

EXTRAS = {
    "lerobot": "av",
    "dm_control": "shimmy",
    "robotics": "gymnasium-robotics",
    "panda": "panda-gym",
    "sb3": "stable-baselines3",
    "ray": "ray",
    "browser": "playwright",
    "hub": "huggingface_hub",
    "wandb": "wandb",
    "mlflow": "mlflow-skinny",
}
"""the package that each of them installs"""
_GLIBC_OF_OPEN3D = (2, 35)  # which its wheels for Python 3.13 are built for


def extras(export: dict) -> Iterable[Finding]:
    """Judge the optional packages.

    Args:
        export: what the probe of Open3D found.
    """
    for extra, package in EXTRAS.items():
        with contextlib.suppress(importlib.metadata.PackageNotFoundError):
            yield Finding(f"extra {extra}", "ok", f"{package} {importlib.metadata.version(package)}")
            continue
        lack = no_panda(sys.version_info[:2], platform.machine()) if extra == "panda" else None
        reason, fix = lack or ("", f"pip install '.[{extra}]'")
        yield Finding(f"extra {extra}", "note", f"{package} is not installed{reason}", fix)
    yield open3d(export, importlib.util.find_spec("open3d") is not None, no_open3d(sys.version_info[:2], glibc()))


def open3d(export: dict, installed: bool, lack: tuple[str, str] | None) -> Finding:
    """Judge Open3D.

    Args:
        export: what its probe found.
        installed: whether it is.
        lack: what :func:`no_open3d` says of this machine.
    """
    if export["ok"]:
        return Finding("extra export", "ok", f"open3d {export['version']}")
    reason, fix = lack or ("", "apt install libusb-1.0-0 libgl1 libgomp1" if installed else "pip install '.[export]'")
    told = shortened(export["error"]) if installed else "open3d is not installed"
    return Finding("extra export", "note", f"{told}{reason}", fix)


def no_panda(python: tuple[int, int], machine: str) -> tuple[str, str] | None:
    """Return why the extra panda cannot be had, and what to do; None if it can.

    Args:
        python: its version.
        machine: the processor, as ``uname -m`` names it.
    """
    if python >= (3, 12):
        version = ".".join(map(str, python))
        reason = f": its simulator PyBullet has no wheels from Python 3.12 on, and this is {version}"
        return reason, "make the environment with Python 3.11"
    if machine != "x86_64":
        reason = f": its simulator PyBullet has wheels for x86_64 only, and this is {machine}"
        return (
            reason,
            "pip install panda-gym, which compiles PyBullet and takes a C++ compiler",
        )
    return None


def no_open3d(python: tuple[int, int], library: tuple[int, int] | None) -> tuple[str, str] | None:
    """Return why Open3D cannot be had, and what to do; None if nothing of the kind is known.

    Args:
        python: its version.
        library: version of glibc; None if the system's C library is another one.
    """
    if python < (3, 13) or (library is not None and library >= _GLIBC_OF_OPEN3D):
        return None
    found = "this system has another C library" if library is None else f"this is {library[0]}.{library[1]}"
    reason = f": its wheels for Python 3.13 need glibc {_GLIBC_OF_OPEN3D[0]}.{_GLIBC_OF_OPEN3D[1]}, and {found}"
    return reason, "make the environment with Python 3.11 or 3.12"


def glibc() -> tuple[int, int] | None:
    """Return the version of glibc; None if the system has another C library."""
    name, version = platform.libc_ver()
    numbers = version.split(".")
    return (int(numbers[0]), int(numbers[1])) if name == "glibc" and len(numbers) > 1 else None
