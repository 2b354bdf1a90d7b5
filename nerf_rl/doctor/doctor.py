"""``nerf-rl doctor``: find out whether this machine has what nerf-rl needs, and say how to mend what is missing."""

import json
import os
import shutil
import subprocess
import sys
from collections.abc import Iterable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

from nerf_rl import __version__
from nerf_rl.doctor.config import DoctorConfig
from nerf_rl.doctor.finding import Finding, shortened
from nerf_rl.doctor.optional_packages import extras
from nerf_rl.doctor.trial import trial
from nerf_rl.errors import FailureError
from nerf_rl.files.json_files import write_json
from nerf_rl.files.outputs import making, plain, require_file_place
from nerf_rl.files.versions import package_versions
from nerf_rl.machine.cores import usable_cores

BACKENDS = {
    "egl": "apt install libegl1 libopengl0 libgl1-mesa-dri",
    "osmesa": "apt install libosmesa6",
    "glfw": "it needs a display; without one, use egl or osmesa",
}
_SOFTWARE = ("llvmpipe", "softpipe", "swrast")
_GIGABYTE = 1e9
_LEAST_SHARED, _ENOUGH_SHARED = 0.06, 0.5  # [GB]; containers start with 0.064
_LEAST_DISK, _ENOUGH_DISK = 1.0, 10.0  # [GB]


def doctor(config: DoctorConfig) -> None:
    """Print what was found, each with its fix, and write it as JSON if asked to.

    Raises:
        UserError: the JSON cannot be written where it is to be.
        FailureError: something that is needed does not work.
    """
    if config.json:  # known before the probes, which take minutes
        require_file_place(Path(config.json))
        with making(Path(config.json)):
            Path(config.json).parent.mkdir(parents=True, exist_ok=True)
    print(f"nerf-rl {__version__}, Python {sys.version.split()[0]}, {sys.executable}")
    findings = [machine(), shared_memory(Path("/dev/shm")), disk(Path(config.folder)), *probed(config.timeout)]
    width = max(len(finding.name) for finding in findings)
    for finding in findings:
        print(f"{finding.status:<8} {finding.name:<{width}}  {finding.detail}")
        if finding.fix:
            print(f"{'':<8} {'':<{width}}  fix: {finding.fix}")
    broken = [finding.name for finding in findings if finding.status == "broken"]
    if config.json:
        report = {"ok": not broken, "findings": plain(findings), "packages": package_versions()}
        with making(Path(config.json)):
            write_json(Path(config.json), report)
    if broken:
        raise FailureError(f"what is needed does not work: {', '.join(broken)}")
    print("everything that is needed works")


def probed(timeout: float) -> Iterable[Finding]:
    """Try out rendering, torch and the extras, each in a process of its own, and then the commands themselves."""
    usable = usable_cores()
    with ThreadPoolExecutor(max(2, usable)) as pool:
        torch = pool.submit(run_probe, "torch", timeout)
        backends = {name: pool.submit(run_probe, "rendering", timeout, name) for name in BACKENDS}
        export = pool.submit(run_probe, "export", timeout)
        yield from rendering({name: probe.result() for name, probe in backends.items()}, os.environ.get("MUJOCO_GL"))
        yield torch_pair(torch.result())
        yield from extras(export.result())
    yield from trial(timeout)


def run_probe(name: str, timeout: float, backend: str = "") -> dict:
    """Run one of :mod:`nerf_rl.doctor.probes`; return what it found, also if it crashed or hung.

    Args:
        name: of the probe.
        timeout: after which it is ended [s].
        backend: for ``MUJOCO_GL``; as it is if empty.
    """
    environment = {**os.environ, "LP_NUM_THREADS": "0", **({"MUJOCO_GL": backend} if backend else {})}
    command = [sys.executable, "-m", "nerf_rl.doctor.probes", name]
    try:
        done = subprocess.run(command, env=environment, capture_output=True, text=True, timeout=timeout)
    except subprocess.TimeoutExpired:
        return {"ok": False, "error": f"it hung for {timeout:.0f} s"}
    try:
        return json.loads(done.stdout.strip().rpartition("\n")[2])
    except ValueError:
        last = done.stderr.strip().rpartition("\n")[2]
        ended = f"it crashed (signal {-done.returncode})" if done.returncode < 0 else f"it ended with {done.returncode}"
        return {"ok": False, "error": f"{ended} {last}".strip()}


def rendering(probes: dict[str, dict], chosen: str | None) -> Iterable[Finding]:
    """Judge the backends: the one that commands will use must work.

    Args:
        probes: what was found, by backend.
        chosen: ``MUJOCO_GL``, which importing nerf_rl fills in.
    """
    working = [name for name, probe in probes.items() if probe["ok"]]
    for name, probe in probes.items():
        used = " (the one in use)" if name == chosen else ""
        if probe["ok"]:
            kind = "software" if any(word in probe["renderer"] for word in _SOFTWARE) else "hardware"
            yield Finding(f"rendering with {name}", "ok", f"{kind} renderer {probe['renderer']}{used}")
            continue
        needed = name == chosen or (chosen not in probes and not working and name == "egl")
        fix = f"export MUJOCO_GL={working[0]}" if needed and working else BACKENDS[name]
        status = "broken" if needed else "note"
        yield Finding(f"rendering with {name}", status, f"{shortened(probe['error'])}{used}", fix)


def torch_pair(probe: dict) -> Finding:
    """Judge torch and TorchRL."""
    if probe["ok"]:
        return Finding("torch", "ok", f"torch {probe['torch']} with torchrl {probe['torchrl']}; {probe['device']}")
    fix = "install a pair that fits: pip install 'torch>=2.14.1,<2.16' 'torchrl>=0.14.1,<0.15'"
    return Finding("torch", "broken", shortened(probe["error"]), fix)


def machine() -> Finding:
    """Report processors and threads."""
    usable, threads = usable_cores(), os.environ.get("OMP_NUM_THREADS")
    limit = f", OMP_NUM_THREADS={threads}" if threads else ""
    return Finding("processors", "ok", f"{usable} of {os.cpu_count()} may be used{limit}; use --workers {usable}")


def shared_memory(folder: Path) -> Finding:
    """Judge the memory that worker processes share."""
    if not folder.is_dir():
        return Finding("shared memory", "broken", f"there is no {folder}", f"mount -t tmpfs shm {folder}")
    free = shutil.disk_usage(folder).free / _GIGABYTE
    if free >= _ENOUGH_SHARED:
        return Finding("shared memory", "ok", f"{free:.1f} GB free in {folder}")
    status = "note" if free >= _LEAST_SHARED else "broken"
    return Finding(
        "shared memory", status, f"{free:.2f} GB free in {folder}", "in a container: docker run --shm-size 2g"
    )


def disk(folder: Path) -> Finding:
    """Judge the free space where results go."""
    there = next(parent for parent in (folder.absolute(), *folder.absolute().parents) if parent.exists())
    free = shutil.disk_usage(there).free / _GIGABYTE
    if free >= _ENOUGH_DISK:
        return Finding("disk", "ok", f"{free:.0f} GB free in {there}")
    status = "note" if free >= _LEAST_DISK else "broken"
    return Finding("disk", status, f"{free:.1f} GB free in {there}", "free some space, or choose another --out")
