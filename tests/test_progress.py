"""The lines of long work where the output is no terminal."""

import pytest

from nerf_rl.progress import Progress


@pytest.mark.parametrize(("most_seconds", "left"), [(1000.0, "45 s left"), (20.0, "20 s left")])
def test_the_time_that_is_left_is_that_of_the_units_or_of_the_budget(
    most_seconds: float, left: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
):
    now = 100.0
    monkeypatch.setattr("time.monotonic", lambda: now)
    monkeypatch.setattr("sys.stderr.isatty", lambda: False)
    with Progress(100, "steps", seconds_between_lines=4.0) as progress:
        now = 105.0
        progress.advance(10, lambda: "a note", most_seconds)
        now = 108.0
        progress.advance(10, lambda: "a note", most_seconds)  # too soon for another line
    assert capsys.readouterr().out == f"10/100 steps, 2.0/s, {left}  a note\n"


def test_no_time_is_left_when_more_is_done_than_was_asked_for(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
):
    now = 100.0
    monkeypatch.setattr("time.monotonic", lambda: now)
    monkeypatch.setattr("sys.stderr.isatty", lambda: False)
    with Progress(450, "env steps") as progress:
        now = 101.0
        progress.advance(452)
    assert capsys.readouterr().out == "452/450 env steps, 452.0/s, 0 s left\n"
