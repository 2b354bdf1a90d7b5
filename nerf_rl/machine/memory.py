"""How much memory a process has taken."""

import contextlib
import resource
import sys
from pathlib import Path


def peak_rss_mb() -> float:
    """Return the peak resident memory of this process so far [MB]."""
    # on Linux, getrusage's figure begins with that of the process that started this; some sandboxes lack the line
    with contextlib.suppress(OSError, IndexError):
        status = Path("/proc/self/status").read_text()
        return int(status.partition("VmHWM:")[2].split()[0]) / 1024
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return peak / (1024 * 1024 if sys.platform == "darwin" else 1024)
