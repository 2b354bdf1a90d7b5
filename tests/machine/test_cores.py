"""How many processors may be used: what the system lets this process run on, less where a container limits its time."""

from pathlib import Path

import pytest

from nerf_rl.machine import cores


@pytest.mark.parametrize(
    ("quota", "expected"),
    [(None, 3), ("max 100000", 3), ("200000 100000", 2), ("150000 100000", 2), ("10000 100000", 1), ("", 3)],
)
def test_a_containers_limit_counts(quota: str | None, expected: int, monkeypatch: pytest.MonkeyPatch, tmp_path: Path):
    monkeypatch.setattr("os.sched_getaffinity", lambda pid: {0, 5, 6}, raising=False)
    monkeypatch.setattr(cores, "_QUOTA", tmp_path / "cpu.max")
    if quota is not None:
        (tmp_path / "cpu.max").write_text(quota)
    assert cores.usable_cores() == expected


def test_a_system_without_affinity_has_all_its_processors(monkeypatch: pytest.MonkeyPatch, tmp_path: Path):
    monkeypatch.setattr(cores, "_QUOTA", tmp_path / "cpu.max")
    monkeypatch.delattr("os.sched_getaffinity", raising=False)
    monkeypatch.setattr("os.cpu_count", lambda: 7)
    assert cores.usable_cores() == 7
    monkeypatch.setattr("os.cpu_count", lambda: None)
    assert cores.usable_cores() == 1
