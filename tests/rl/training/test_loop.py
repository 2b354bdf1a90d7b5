"""The training loop on the tiny environment: it learns, is repeatable, and resumes exactly."""

import csv
import itertools
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from gymnasium.vector import AsyncVectorEnv
from tensorboard.backend.event_processing.event_accumulator import EventAccumulator
from tiny_environment import point_envs
from tiny_run import config, train

from nerf_rl.errors import DivergedError, UserError
from nerf_rl.files.tensor_files import read_tensors, write_tensors
from nerf_rl.rl.training.checkpoint import last_checkpoint
from nerf_rl.rl.training.episodes import evaluation_seeds, run_episodes
from nerf_rl.rl.training.loop import Trainer


def test_it_solves_a_tiny_task(envs: AsyncVectorEnv, tmp_path: Path) -> None:
    trainer = Trainer(config(tmp_path), envs, tmp_path)
    before, after = trainer.evaluate(10), []
    for until in (1500, 2000, 2500):  # a policy that has learnt may for a while step over the goal to and fro
        train(trainer, until)
        after.append(trainer.evaluate(20))
    trainer.replay.close()
    assert max(result["success_rate"] for result in after) >= 0.9 > before["success_rate"]
    assert after[-1]["env_steps"] == trainer.env_steps == 2500
    positions = np.array([[-0.8, 2], [0.8, 2]], np.float32)
    assert np.sign(trainer.agent.act(positions)[:, 0]).tolist() == [1, -1]
    rows = (tmp_path / "metrics.csv").read_text().splitlines()
    assert [row.split(",")[0] for row in rows[1:]] == ["1000", "1500", "2000", "2500"]


def test_what_is_evaluated_is_the_policy_that_is_kept(envs: AsyncVectorEnv, tmp_path: Path) -> None:
    trainer = Trainer(config(tmp_path), envs, tmp_path)
    with torch.no_grad():
        for weights in trainer.agent.policy()[1].parameters():
            weights.zero_()  # a policy that stands still
    trainer.replay.close()
    explored = trainer.agent.act(np.array([[-0.8, 2], [0.8, 2]], np.float32))
    assert explored.any(), "exploration goes on with the last weights"
    still = run_episodes(envs, lambda observation: np.zeros((len(observation), 1)), evaluation_seeds(0, 4))
    assert trainer.evaluate(4)["mean_return"] == still.returns.mean()


def test_training_episodes_end_so_many_steps_after_their_success_once_many_succeed(
    envs: AsyncVectorEnv, tmp_path: Path
) -> None:
    trainer = Trainer(config(tmp_path, episode_steps=12, steps_after_success=4), envs, tmp_path)
    train(trainer, 1800)
    rows = trainer.replay.rows(0, trainer.replay.stored)
    trainer.replay.close()
    monitor = [row.split(",") for row in (tmp_path / "monitor.csv").read_text().splitlines()[1:]]
    length, success = (monitor[0].index(name) for name in ("l", "is_success"))
    lengths = {told: [int(row[length]) for row in monitor[1:] if row[success] == told] for told in "01"}
    assert set(lengths["0"]) == {12} == set(lengths["1"][:10])
    assert set(lengths["1"]) <= {6, 8, 10, 12} and min(lengths["1"]) < 12, "two steps with the success, and four more"
    size = trainer.observation_size
    discount, then = rows[:, size + 2], rows[:, size + 3 :]  # [observation, one action, reward, discount, next]
    assert (discount > 0).all(), "what is broken off goes on to be worth something"
    assert (then[:, 1] >= 2).all(), "the last of its observations is its own, and no reset's"


def test_training_episodes_that_succeed_late_go_on_and_evaluated_ones_do_not(
    envs: AsyncVectorEnv, tmp_path: Path
) -> None:
    trainer = Trainer(config(tmp_path, episode_steps=12, success_overtime=6, evaluation_to_end=True), envs, tmp_path)
    train(trainer, 1500)
    trainer.evaluate(10)
    trainer.replay.close()
    monitor = [row.split(",") for row in (tmp_path / "monitor.csv").read_text().splitlines()[1:]]
    length, success = (monitor[0].index(name) for name in ("l", "is_success"))
    lengths = {told: {int(row[length]) for row in monitor[1:] if row[success] == told} for told in "01"}
    assert lengths["0"] == {12} and 12 < max(lengths["1"]) <= 18
    with np.load(tmp_path / "evaluations.npz", allow_pickle=False) as file:
        assert file["successes"].any() and set(np.unique(file["ep_lengths"])) == {12}


def test_a_bonus_for_success_is_learnt_from_and_told_nowhere(envs: AsyncVectorEnv, tmp_path: Path) -> None:
    rows, monitors = [], []
    for bonus in (0.0, 5.0):
        run = tmp_path / str(bonus)
        run.mkdir()
        made = config(run, success_bonus=bonus, learning_starts=1000)  # both act alike until they have learnt
        trainer = Trainer(made, envs, run)
        train(trainer, 480)
        rows.append(trainer.replay.rows(0, trainer.replay.stored))
        monitors.append([line.split(",")[:2] for line in (run / "monitor.csv").read_text().splitlines()[2:]])
        reward, n_step, gamma = trainer.observation_size + 1, made.learner.n_step, made.learner.gamma
        trainer.replay.close()
    assert monitors[0] == monitors[1]
    more = rows[1] - rows[0]
    gained, others = more[:, reward], np.delete(more.numpy(), reward, axis=1)
    assert not others.any()
    of_steps = [5.0 * gamma**step for step in range(n_step)]
    sums = [sum(chosen) for count in range(n_step + 1) for chosen in itertools.combinations(of_steps, count)]
    assert all(min(abs(value - one) for one in sums) < 1e-4 for value in gained.tolist())
    assert gained.any() and not gained.all()


def test_evaluated_episodes_do_not_end_after_their_success(envs: AsyncVectorEnv, tmp_path: Path) -> None:
    trainer = Trainer(config(tmp_path, episode_steps=12, steps_after_success=2, evaluation_to_end=True), envs, tmp_path)
    train(trainer, 1500)
    trainer.evaluate(10)
    trainer.replay.close()
    with np.load(tmp_path / "evaluations.npz", allow_pickle=False) as file:
        assert file["successes"].any() and set(np.unique(file["ep_lengths"])) == {12}


@pytest.mark.parametrize(("learning_starts", "updates"), [(None, 24), (80, 34), (140, 4)])
def test_updates_begin_where_they_are_told_to(
    envs: AsyncVectorEnv, tmp_path: Path, learning_starts: int | None, updates: int
) -> None:
    trainer = Trainer(config(tmp_path, learning_starts=learning_starts), envs, tmp_path)
    train(trainer, 148)
    trainer.replay.close()
    assert trainer.agent.updates == updates


def test_a_resumed_run_ends_bit_for_bit_like_an_uninterrupted_one(envs: AsyncVectorEnv, tmp_path: Path) -> None:
    def finish(trainer: Trainer, from_step: int) -> dict[str, torch.Tensor]:
        if from_step == 0:
            train(trainer, 300)
            trainer.evaluate(2)
            trainer.save()
        train(trainer, 620)
        trainer.replay.close()
        return trainer.agent.actor.state_dict() | trainer.agent.target_critic.state_dict()

    run = tmp_path / "run"
    run.mkdir()
    uninterrupted = Trainer(config(run), envs, run)
    wanted = finish(uninterrupted, 0)
    resumed = Trainer(config(run, resume=True), envs, run)
    assert resumed.env_steps == 300
    assert resumed.evaluations == uninterrupted.evaluations
    found = finish(resumed, 300)
    assert all(torch.equal(found[name], wanted[name]) for name in wanted)
    assert resumed.agent.updates == uninterrupted.agent.updates
    assert resumed.episodes == uninterrupted.episodes
    for trainer in (uninterrupted, resumed):
        for logger in trainer.metrics.loggers:
            logger.finalize("success")
    with open(run / "metrics.csv", newline="") as file:
        rows = [int(row["env_steps"]) for row in csv.DictReader(file)]
    curve = EventAccumulator(str(run / "logs")).Reload().Scalars("train/q")
    assert [point.step for point in curve] == rows == sorted(set(rows)), "each step is there once"


def test_only_the_newest_complete_checkpoint_is_kept(envs: AsyncVectorEnv, tmp_path: Path) -> None:
    trainer = Trainer(config(tmp_path), envs, tmp_path)
    for until in (24, 72):
        train(trainer, until)
        trainer.save()
    trainer.replay.close()
    (tmp_path / "checkpoints" / "partial").mkdir()
    assert last_checkpoint(tmp_path) == tmp_path / "checkpoints" / "00000072"
    assert sorted(path.name for path in (tmp_path / "checkpoints").iterdir()) == ["00000072", "partial"]
    assert {path.suffix for path in (tmp_path / "checkpoints").rglob("*") if path.is_file()} <= {
        ".csv",
        ".json",
        ".safetensors",
    }


def test_a_checkpoint_with_an_impossible_random_state_is_told_of(envs: AsyncVectorEnv, tmp_path: Path) -> None:
    trainer = Trainer(config(tmp_path), envs, tmp_path)
    train(trainer, 72)
    trainer.save()
    trainer.replay.close()
    path = tmp_path / "checkpoints" / "00000072" / "state.safetensors"
    tensors = read_tensors(path)
    write_tensors(path, tensors | {"torch_rng": torch.full_like(tensors["torch_rng"], 255)})
    with pytest.raises(UserError, match="00000072 is damaged"):
        Trainer(config(tmp_path, resume=True), envs, tmp_path)


def test_a_run_whose_returns_are_no_numbers_says_that_it_diverged(
    envs: AsyncVectorEnv, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    step = envs.step_wait

    def senseless(*arguments: Any, **keys: Any) -> Any:
        observation, reward, *rest = step(*arguments, **keys)
        return (observation, np.full_like(reward, np.nan), *rest)

    trainer = Trainer(config(tmp_path), envs, tmp_path)
    train(trainer, 48)
    monkeypatch.setattr(envs, "step_wait", senseless)
    with pytest.raises(
        DivergedError, match="the run diverged: after 48 env steps the mean return of 3 evaluated"
    ) as told:
        trainer.evaluate(3)
    trainer.replay.close()
    assert told.value.env_steps == 48 and not trainer.evaluations


def test_a_policy_whose_actions_are_no_numbers_is_not_evaluated_and_not_kept(
    envs: AsyncVectorEnv, tmp_path: Path
) -> None:
    """MuJoCo takes such an action for none, so that returns would be numbers."""
    trainer = Trainer(config(tmp_path), envs, tmp_path)
    train(trainer, 48)
    trainer.save()
    kept = sorted((tmp_path / "checkpoints").iterdir())
    with torch.no_grad():
        for weights in trainer.agent.policy()[1].parameters():
            weights.fill_(torch.nan)
    with pytest.raises(DivergedError, match="evaluated episodes, or an action in them, is not a number"):
        trainer.evaluate(3)
    train(trainer, 72)
    with pytest.raises(DivergedError, match="after 72 env steps a weight of the agent is not a number"):
        trainer.save()
    trainer.replay.close()
    assert not trainer.evaluations and sorted((tmp_path / "checkpoints").iterdir()) == kept


@pytest.mark.parametrize("told", [True, False])
def test_exploration_waits_for_a_success_where_the_scene_tells_of_it(
    told: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """So that an agent which found a place of rest first still looks further; a resumed run does so, too."""
    envs = point_envs(2, steps=12, repeat=2)
    step = envs.step_wait

    def never(*arguments: Any, **keys: Any) -> Any:
        *rest, info = step(*arguments, **keys)
        success = {"success": np.zeros(2, np.bool_)} if told else {}
        return (*rest, {key: value for key, value in info.items() if key != "success"} | success)

    made = config(tmp_path)
    made.noise.wait_for_successes = 2
    try:
        monkeypatch.setattr(envs, "step_wait", never)
        trainer = Trainer(made, envs, tmp_path)
        train(trainer, 600)
        assert trainer._exploration.scale(600) == (1.0 if told else pytest.approx(1.0 - 0.95 * 600 / 1500))
        trainer.save()
        trainer.replay.close()
        monkeypatch.setattr(envs, "step_wait", step)
        made.resume = True
        resumed = Trainer(made, envs, tmp_path)
        before = resumed._exploration.elapsed(600)
        train(resumed, 1500)  # by then there was a success, as a point on a line cannot help it
        assert before == (0 if told else 600) and before + 300 < resumed._exploration.elapsed(1500) <= before + 900
        resumed.replay.close()
    finally:
        envs.close(terminate=True)


def test_no_success_is_lost_where_every_episode_is_broken_off(tmp_path: Path) -> None:
    """As with evaluations that come more often than episodes end."""
    made = config(tmp_path, retry_share=0.5, echo_share=0.5)
    made.noise.wait_for_successes = 2
    envs = point_envs(2, steps=12)
    try:
        trainer = Trainer(made, envs, tmp_path)
        for until in range(8, 800, 8):
            train(trainer, until)
        trainer.replay.close()
    finally:
        envs.close(terminate=True)
    assert trainer.episodes == 2 * len(range(8, 800, 8)), "none came to its end"
    assert trainer._exploration.elapsed(trainer.env_steps) > 0 and trainer._monitor.stuck_for(trainer.env_steps) < 400
    assert len(trainer._echoes) > 2 and any(trainer._curriculum.state_dict()["recent"])


def test_an_agent_that_stays_stuck_starts_anew_from_its_memory_and_a_resumed_run_does_so_too(
    envs: AsyncVectorEnv, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    def stuck(run: Path, resume: bool = False) -> Trainer:
        run.mkdir(exist_ok=True)
        made = config(run, log_every=50, resume=resume)
        made.learner.reset_after, made.learner.reset_updates = 100, 20
        trainer = Trainer(made, envs, run)
        trainer._monitor.end_episode = lambda *_: None  # type: ignore[method-assign]  # nothing is ever a success
        return trainer

    whole = stuck(tmp_path / "whole")
    train(whole, 200)
    before = [parameter.clone() for parameter in whole.agent.policy().parameters()]
    stored, updates = len(whole.replay), whole.agent.updates
    whole.save()
    shutil.copytree(tmp_path / "whole" / "checkpoints", tmp_path / "again" / "checkpoints")
    assert "nothing has improved" in capsys.readouterr().out
    assert whole._exploration.elapsed(200) < 200, "exploration starts anew, too"
    train(whole, 400)
    again = stuck(tmp_path / "again", resume=True)
    train(again, 400)
    for trainer in (whole, again):
        assert len(trainer.replay) > stored and trainer.agent.updates > updates + 20
        trainer.replay.close()
    states = [trainer.agent.state_dict() for trainer in (whole, again)]
    assert all(torch.equal(states[0][name], states[1][name]) for name in states[0])
    assert any((a != b).any() for a, b in zip(before, whole.agent.policy().parameters(), strict=True))


def test_networks_start_anew_where_they_still_learn_and_not_before_they_are_kept(
    envs: AsyncVectorEnv, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    made = config(tmp_path, log_every=10_000)
    made.learner.reset_after, made.learner.reset_updates = 100, 20
    trainer, resets = Trainer(made, envs, tmp_path), []
    reset = trainer.agent.reset
    monkeypatch.setattr(trainer._monitor, "end_episode", lambda *_: None)  # nothing is ever a success
    monkeypatch.setattr(trainer.agent, "reset", lambda: (resets.append(trainer.env_steps), reset()))
    train(trainer, 300)
    assert trainer._monitor.stuck_for(300) >= 100 and not resets
    updates = trainer.agent.updates
    train(trainer, 310)
    assert resets == [300] and trainer.agent.updates >= updates + 20
    trainer.replay.close()


def test_an_evaluated_policy_sees_one_environment_at_a_time(envs: AsyncVectorEnv) -> None:
    """Of a batch, the last bits of a product of matrices differ with the number of rows."""
    seen = []

    def act(observation: np.ndarray) -> np.ndarray:
        seen.append(len(observation))
        return np.zeros((len(observation), *(envs.single_action_space.shape or ())), np.float32)

    run_episodes(envs, act, evaluation_seeds(0, 3))
    assert envs.num_envs > 1 and set(seen) == {1}


def test_a_checkpoint_that_is_written_anew_is_never_missing(
    envs: AsyncVectorEnv, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    run = tmp_path / "run"
    run.mkdir()
    trainer = Trainer(config(run), envs, run)
    train(trainer, 300)
    trainer.save()

    def killed(source: Path, target: Path) -> None:
        raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr("nerf_rl.rl.training.checkpoint.rename_durably", killed)
        with pytest.raises(KeyboardInterrupt):
            trainer.save()
    left = last_checkpoint(run)
    assert left is not None and int(left.name) == trainer.env_steps
    trainer.save()
    assert [path.name for path in (run / "checkpoints").iterdir()] == [f"{trainer.env_steps:08d}"]
    trainer.replay.close()
