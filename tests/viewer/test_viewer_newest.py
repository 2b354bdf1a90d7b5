"""Work of which only the newest order matters."""

import threading
from collections.abc import Callable

import pytest

from nerf_rl.viewer.newest import NewestOnly


def test_orders_that_came_too_late_are_forgotten_and_the_last_one_is_done() -> None:
    begun, go_on = threading.Event(), threading.Event()
    done: list[tuple[int, bool]] = []

    def work(order: int, stale: Callable[[], bool]) -> None:
        begun.set()
        go_on.wait(5.0)
        done.append((order, stale()))

    worker: NewestOnly[int] = NewestOnly(work)
    worker.order(0)
    assert begun.wait(5.0)
    for order in (1, 2, 3):
        worker.order(order)
    go_on.set()
    assert worker.wait(5.0)
    worker.close()
    assert done == [(0, True), (3, False)]


def test_a_failure_does_not_end_the_worker(capsys: pytest.CaptureFixture[str]) -> None:
    done = []
    worker: NewestOnly[int] = NewestOnly(lambda order, _: done.append(1 // order))
    worker.order(0)
    assert worker.wait(5.0)
    worker.order(1)
    assert worker.wait(5.0) and done == [1]
    worker.close()
    assert "ZeroDivisionError" in capsys.readouterr().err
