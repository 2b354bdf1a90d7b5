"""Processes that calls are handed to: results as they come, errors and deaths as what they are, nothing left behind."""

import contextlib
import functools
import os
import signal
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from nerf_rl.machine.worker_pools import LocalProcesses


def started(folder: Path, name: str) -> int:
    """Leave a file that says that this process has begun; return the process."""
    (folder / name).touch()
    return os.getpid()


def wait_for(path: Path) -> str:
    """Return a file's name once it is there."""
    for _ in range(6000):
        if path.exists():
            return path.name
        time.sleep(0.01)
    raise AssertionError(f"{path} did not come")


def wait_after(folder: Path, name: str, other: str) -> str:
    """Say that this call has begun, wait for another one, and return the name of this one."""
    started(folder, name)
    wait_for(folder / other)
    return name


def hang(folder: Path) -> None:
    """Say which process this is, and do nothing for very long."""
    (folder / "begun").write_text(str(os.getpid()))
    time.sleep(3600)


def mistaken() -> None:
    raise KeyError("a mistake of the call's own")


def die() -> None:
    os.kill(os.getpid(), signal.SIGKILL)


def is_running(pid: int) -> bool:
    status = Path(f"/proc/{pid}/stat")
    return status.exists() and status.read_text().rpartition(")")[2].split()[0] != "Z"


@pytest.fixture
def pool() -> LocalProcesses:
    return LocalProcesses([__name__])


def test_results_come_in_the_order_in_which_calls_end(pool: LocalProcesses, tmp_path: Path):
    calls = [
        functools.partial(wait_after, tmp_path, "first", "released"),
        functools.partial(started, tmp_path, "second"),
    ]
    with contextlib.closing(pool.as_they_end(calls, 2)) as results:
        assert isinstance(next(results), int)  # the second one's, while the first one waits
        (tmp_path / "released").touch()
        assert list(results) == ["first"]


def test_as_many_run_at_a_time_as_there_are_workers(pool: LocalProcesses, tmp_path: Path):
    names = ["a", "b"]
    together = [functools.partial(wait_after, tmp_path, *pair) for pair in (names, names[::-1])]  # each needs the other
    assert sorted(pool.as_they_end(together, 2)) == names
    processes = list(pool.as_they_end([functools.partial(started, tmp_path, str(i)) for i in range(5)], 1))
    assert len(processes) == 5 and len(set(processes)) == 1 and processes[0] != os.getpid()


def test_calls_are_taken_when_their_turn_comes(pool: LocalProcesses, tmp_path: Path):
    taken = []

    def calls() -> Iterator[functools.partial]:
        for number in range(50):
            taken.append(number)
            yield functools.partial(started, tmp_path, str(number))

    with contextlib.closing(pool.as_they_end(calls(), 1)) as results:
        next(results)
        assert len(taken) < 5


def test_who_stops_early_leaves_no_process(pool: LocalProcesses, tmp_path: Path):
    calls = [functools.partial(hang, tmp_path), functools.partial(wait_for, tmp_path / "begun")]
    with contextlib.closing(pool.as_they_end(calls, 2)) as results:
        assert next(results) == "begun"
        hanging = int((tmp_path / "begun").read_text())
        assert is_running(hanging)
    for _ in range(600):
        if not is_running(hanging):
            return
        time.sleep(0.05)
    raise AssertionError("it still runs")


def test_an_error_of_a_call_is_raised_and_is_no_death(pool: LocalProcesses):
    with pytest.raises(KeyError, match="a mistake of the call's own") as raised:
        list(pool.as_they_end([mistaken], 1))
    assert not isinstance(raised.value, pool.deaths)


def test_a_process_that_dies_is_told_of(pool: LocalProcesses):
    with pytest.raises(pool.deaths):
        list(pool.as_they_end([die], 1))
    assert list(pool.as_they_end([os.getppid], 1)) != [os.getpid()]  # others can be started after that
