"""Peak memory where /proc tells, and where only getrusage does, in the units of each system."""

import resource
from pathlib import Path

import pytest

from nerf_rl.machine import memory


def test_peak_memory_is_that_of_this_process():
    block = bytearray(64 << 20)
    block[:: 1 << 12] = b"x" * len(block[:: 1 << 12])
    assert memory.peak_rss_mb() > 64


@pytest.mark.parametrize("platform, unit", [("linux", 1024), ("darwin", 1024 * 1024)])
@pytest.mark.parametrize("status", [None, "Name:\tpython\nVmRSS:\t100 kB\n"])
def test_without_proc_getrusage_counts_in_its_own_units(
    status: str | None, platform: str, unit: int, monkeypatch: pytest.MonkeyPatch
):
    """Nor does a sandbox's tell the peak."""

    def absent(path: Path) -> str:
        if status is None:
            raise FileNotFoundError(path)
        return status

    monkeypatch.setattr(Path, "read_text", absent)
    monkeypatch.setattr(memory.sys, "platform", platform)
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    assert memory.peak_rss_mb() == pytest.approx(peak / unit, rel=0.01)
