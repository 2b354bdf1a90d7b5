"""What RL Zoo's plot scripts read, read back as they do it: by Stable-Baselines3 and NumPy without pickle."""

import csv
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from tiny_recipes import TINY_TRAINING

from nerf_rl import cli
from nerf_rl.rl.training.curves import MetricsLog
from nerf_rl.rl.training.episodes import Episodes
from nerf_rl.rl.training.zoo_files import EVALUATIONS_NPZ, MONITOR, ZooFiles


def load_results(run: Path) -> Any:
    """Return the training episodes of a run, as a table, by the function that the Zoo's plot_train calls."""
    pytest.importorskip("pandas", reason="Stable-Baselines3 reads monitor.csv with pandas, which is not installed")
    monitor = pytest.importorskip("stable_baselines3.common.monitor", reason="the extra sb3 is not installed")
    return monitor.load_results(str(run))


def evaluations(run: Path) -> dict[str, np.ndarray]:
    with np.load(run / EVALUATIONS_NPZ, allow_pickle=False) as file:
        return {name: file[name] for name in file.files}


def found(*returns: float, success: bool | None = True) -> Episodes:
    numbers = np.array(returns, np.float64)
    told = None if success is None else np.full(len(numbers), success)
    return Episodes(told, numbers, np.arange(len(numbers)) + 1)


@pytest.mark.parametrize(
    "algo", [["--algo", "ddpg"], ["--algo", "ppo", "--ppo.n_steps", "20", "--ppo.batch_size", "20"]]
)
def test_a_run_can_be_read_by_the_zoos_plot_scripts(algo: list[str], tmp_path: Path):
    run = tmp_path / "drawer-open_1"
    pytest.importorskip("stable_baselines3", reason="the extra sb3 is not installed")
    keys = [*TINY_TRAINING, "--final_evaluation_episodes", "3", *algo]
    assert cli.main(["train-rl", "--out", str(run), *keys, "--episode_steps", "10"]) == 0
    episodes = load_results(run)
    from stable_baselines3.common import results_plotter as plotter

    x, y = plotter.ts2xy(episodes, plotter.X_TIMESTEPS)
    assert list(y) == list(episodes["r"]) and list(x) == list(np.cumsum(episodes["l"]))
    assert set(episodes["l"]) == {10} and len(episodes) >= 4 and x[-1] <= 80
    assert set(episodes["is_success"]) <= {0, 1} and (np.diff(episodes["t"]) >= 0).all()

    summary = json.loads((run / "summary.json").read_text())
    log = evaluations(run)
    assert log["timesteps"].tolist() == [evaluation["env_steps"] for evaluation in summary["evaluations"]]
    assert log["results"].shape == log["ep_lengths"].shape == log["successes"].shape == (2, 2)
    assert np.allclose(log["results"][0].mean(), summary["evaluations"][0]["mean_return"])


def test_a_resumed_run_has_each_episode_and_evaluation_once(tmp_path: Path):
    files = ZooFiles(tmp_path, "scene")
    for step in (10, 20, 30):
        files.add_episode(step / 10, 10, step / 100, None, step)
        files.add_evaluation(step, found(step, step + 1))
    with open(tmp_path / MONITOR, "a") as file:
        file.write("1.0,1")  # cut off while it was written
    begun = (tmp_path / MONITOR).read_text().splitlines()[0]
    files = ZooFiles(tmp_path, "scene", 20)
    files.add_episode(7.0, 10, 0.5, True, 40)
    files.add_evaluation(40, found(40, 41))
    assert (tmp_path / MONITOR).read_text().splitlines()[0] == begun
    assert list(load_results(tmp_path)["r"]) == [1.0, 2.0, 7.0]
    assert evaluations(tmp_path)["timesteps"].tolist() == [10, 20, 40]
    assert evaluations(tmp_path)["results"].tolist() == [[10, 11], [20, 21], [40, 41]]


def test_a_run_that_begins_anew_forgets_what_was_there(tmp_path: Path):
    files = ZooFiles(tmp_path, "scene")
    files.add_episode(1.0, 10, 0.1, None, 10)
    files.add_evaluation(10, found(1.0))
    ZooFiles(tmp_path, "scene")
    assert len(load_results(tmp_path)) == 0
    assert not (tmp_path / EVALUATIONS_NPZ).exists()


@pytest.mark.parametrize("counts, kept", [((2, 3), 2), ((3, 2), 2), ((1, 1), 1)])
def test_evaluations_of_different_size_keep_the_seeds_that_they_share(
    counts: tuple[int, int], kept: int, tmp_path: Path
):
    files = ZooFiles(tmp_path, "scene")
    for number, count in enumerate(counts):
        files.add_evaluation(number, found(*np.arange(count) + 10.0 * number, success=None))
    log = evaluations(tmp_path)
    assert log["results"].tolist() == [[10.0 * number + seed for seed in range(kept)] for number in range(2)]
    assert "successes" not in log


@pytest.mark.parametrize("content", [b"", b"PK\x03\x04 but no more", b"#{}\nr\n1\n"])
def test_damaged_files_do_not_hold_up_a_resumed_run(content: bytes, tmp_path: Path):
    for name in (MONITOR, EVALUATIONS_NPZ):
        (tmp_path / name).write_bytes(content)
    files = ZooFiles(tmp_path, "scene", 50)
    files.add_episode(1.0, 10, 0.1, False, 60)
    files.add_evaluation(60, found(1.0))
    with open(tmp_path / MONITOR, newline="") as file:
        assert json.loads(file.readline()[1:])["env_id"] == "scene"
        assert [row["env_steps"] for row in csv.DictReader(file)] == ["60"]
    assert evaluations(tmp_path)["timesteps"].tolist() == [60]


def test_nothing_pickled_is_read_from_a_run_folder(tmp_path: Path):
    class Trap:
        def __reduce__(self) -> tuple:
            return (Path.touch, (tmp_path / "sprung",))

    trap = np.empty(1, object)
    trap[0] = Trap()
    np.savez(tmp_path / EVALUATIONS_NPZ, timesteps=np.array([1]), results=trap)
    ZooFiles(tmp_path, "scene", 5).add_evaluation(6, found(1.0))
    assert not (tmp_path / "sprung").exists()
    assert evaluations(tmp_path)["timesteps"].tolist() == [6]


@pytest.mark.parametrize("tail", [b"90", b"90" + b"," * 20, b"abc,def\n", b"\0\0\0\n", b"\xff\n", b"90,1.0\n"])
def test_what_a_crash_leaves_behind_the_rows_of_metrics_does_not_hold_up_a_resumed_run(tail: bytes, tmp_path: Path):
    path = tmp_path / "metrics.csv"
    before = MetricsLog(path)
    for env_steps in (40, 80):
        before.write(env_steps=env_steps, seconds=1.0)
    whole = path.read_bytes()
    path.write_bytes(whole + tail)
    MetricsLog(path, 100)
    assert path.read_bytes() == whole
