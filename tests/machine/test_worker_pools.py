"""Processes that work is handed to: each goes on to the end of the work, however much memory it takes."""

import contextlib
import os
import time

import numpy as np
from joblib import delayed

from nerf_rl.machine.worker_pools import as_they_end, open_backend

_kept = []


def take_memory(megabytes: int) -> int:
    """Take memory for good, and as long as loky waits between two looks at a process; return the process."""
    _kept.append(np.ones(megabytes * 2**20, np.uint8))
    time.sleep(1.2)
    return os.getpid()


def test_a_worker_is_not_replaced_for_the_memory_that_its_first_piece_of_work_took() -> None:
    calls = (delayed(take_memory)(megabytes) for megabytes in (400, 1, 1))
    with contextlib.closing(as_they_end(calls, 1, open_backend("loky")[0])) as processes:
        assert len(set(processes)) == 1
