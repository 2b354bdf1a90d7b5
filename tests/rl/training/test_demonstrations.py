"""Demonstrations: what is acted, how it stays in memory, how an agent begins with it, and what is told of it."""

import dataclasses
import json
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from gymnasium.vector import AsyncVectorEnv
from tiny_recipes import TINY_TRAINING

from nerf_rl import cli
from nerf_rl.errors import FailureError, MissingFileError, UserError
from nerf_rl.files.tensor_files import read_tensors
from nerf_rl.progress import Progress
from nerf_rl.rl.config import LearnerConfig, NetworkConfig, ReplayConfig, TrainRLConfig
from nerf_rl.rl.environments.make import EnvSpec, make_env, make_vector_env
from nerf_rl.rl.experience.n_step import Transition
from nerf_rl.rl.experience.replay import Replay
from nerf_rl.rl.training.demonstrations import act_demonstrations, demonstration_seeds
from nerf_rl.rl.training.episodes import evaluation_seeds, training_seed
from nerf_rl.rl.training.loop import Trainer

STEPS = 160
SPEC = EnvSpec("metaworld/drawer-open-v3", None, 2, STEPS)
COMMAND = [*TINY_TRAINING, "--episode_steps", str(STEPS), "--demonstrations", "1", "--learner.clone_steps", "20"]
COMMAND += ["--env_steps", str(STEPS + 80), "--evaluation_every", "240", "--loggers", "[]"]


@pytest.fixture(scope="module")
def envs() -> AsyncVectorEnv:
    envs = make_vector_env(SPEC, 2)
    yield envs
    envs.close(terminate=True)


def config(run: Path, count: int = 1, **keys: Any) -> TrainRLConfig:
    return TrainRLConfig(
        str(run),
        env_steps=4000,
        warmup_steps=100,
        episode_steps=STEPS,
        demonstrations=count,
        network=NetworkConfig(hidden=[32, 32]),
        learner=LearnerConfig(batch_size=32, actor_rate=1e-3, clone_steps=200),
        replay=ReplayConfig(capacity=90),
        loggers=[],
        **keys,
    )


def demonstrate(trainer: Trainer) -> None:
    with Progress(4000, "env steps") as progress:
        trainer.demonstrate(progress)


def train(trainer: Trainer, until: int) -> None:
    with Progress(until, "env steps", done=trainer.env_steps) as progress:
        trainer.train(progress, until)


def test_the_script_reads_the_scenes_own_observation_and_begins_anew_with_each_episode() -> None:
    env, scene = make_env(SPEC)
    assert scene is not None
    raw: list[np.ndarray] = []
    for seed in (3, 4):
        observation, _ = env.reset(seed=seed)
        raw.append(observation)
        policy = scene.scripted_policy()
        for _ in range(3):
            wanted = policy(observation.astype(np.float64))
            action = env.get_wrapper_attr("scripted_action")()
            assert np.abs(action).max() <= 1 and np.allclose(action, wanted, atol=1e-4)
            observation = env.step(action)[0]
    assert not np.array_equal(*raw)
    env.close()


def test_demonstrations_succeed_and_depend_on_the_seed_and_not_on_the_number_of_environments(
    envs: AsyncVectorEnv,
) -> None:
    two = act_demonstrations(envs, 3, 0.2, seed=5)
    single = make_vector_env(SPEC, 1)
    one = act_demonstrations(single, 3, 0.2, seed=5)
    single.close(terminate=True)
    assert (one.tries, one.env_steps) == (two.tries, two.env_steps) == (one.tries, one.tries * STEPS)
    assert len(one.kept) == len(two.kept) == 3
    for a, b in zip(one.kept, two.kept, strict=True):
        assert a.success and not a.terminated and a.env_steps == STEPS
        assert all(np.array_equal(x, y) for x, y in zip(a[:3], b[:3], strict=True))
        assert a.observations.shape == (STEPS // 2 + 1, 39) and np.abs(a.actions).max() <= 1
    other = act_demonstrations(envs, 1, 0.2, seed=6)
    assert not np.array_equal(other.kept[0].observations, one.kept[0].observations)


def test_a_demonstrations_transitions_are_those_of_training(envs: AsyncVectorEnv) -> None:
    episode = act_demonstrations(envs, 1, 0.0, seed=1).kept[0]
    transitions = episode.transitions(3, 0.9)
    assert len(transitions) == len(episode.actions)
    r, o = episode.rewards, episode.observations
    assert transitions[4].reward == pytest.approx(r[4] + 0.9 * r[5] + 0.81 * r[6], rel=1e-6)
    assert np.array_equal(transitions[4].next_observation, o[7]) and transitions[4].discount == pytest.approx(0.9**3)
    assert np.array_equal(transitions[-1].next_observation, o[-1])
    assert transitions[-1].discount == pytest.approx(0.9), "a time limit is no end"


def test_a_success_is_worth_more_in_demonstrations_too_if_the_run_says_so(envs: AsyncVectorEnv) -> None:
    plain, more = (act_demonstrations(envs, 1, 0.0, 1, bonus).kept[0] for bonus in (0.0, 20.0))
    assert np.array_equal(plain.actions, more.actions)
    added = more.rewards - plain.rewards
    assert np.isclose(added, 20.0).any() and added[0] == 0.0, "the script opens the drawer after a while"
    assert (np.isclose(added, 20.0) | (added == 0.0)).all()


def test_seeds_are_those_of_neither_training_nor_evaluation() -> None:
    shown = {demonstration_seeds(0, episode)[0] for episode in range(200)}
    others = {training_seed(0, env, episode) for env in range(4) for episode in range(200)}
    assert len(shown) == 200 and not shown & (others | {*evaluation_seeds(0, 200), *evaluation_seeds(1, 200)})


def test_a_script_that_hardly_ever_succeeds_is_told(envs: AsyncVectorEnv) -> None:
    sentence = (
        "the scripted policy succeeded in 0 of 10 episodes, too few for --demonstrations 1; lower --demonstration_noise"
    )
    with pytest.raises(FailureError, match=sentence):
        act_demonstrations(envs, 1, 1000.0, seed=0)


def filled(folder: Path, **keys: Any) -> Replay:
    replay = Replay(ReplayConfig(capacity=50, **keys), 3, 2, 40, folder)
    replay.add([transition(0)] * 20)
    replay.demonstrate([transition(-1), transition(-2)])
    return replay


def transition(i: int) -> Transition:
    return Transition(np.full(3, i), np.full(2, i), float(i), 0.9, np.full(3, i))


@pytest.mark.parametrize(("share", "shown"), [(0.99, 39), (0.5, 20), (0.25, 10), (0.0, 0)])
def test_a_share_of_each_batch_is_of_demonstrations_with_the_mean_weight(
    tmp_path: Path, share: float, shown: int
) -> None:
    replay = filled(tmp_path / "replay", demonstration_share=share)
    replay.update_priority(torch.arange(20), torch.linspace(0.1, 5, 20))
    for _ in range(5):
        batch = replay.sample(1.0)
        first = 40 - shown
        assert len(batch.indices) == 40 and (batch.observation[:first] == 0).all()
        assert (batch.observation[first:] < 0).all() and (batch.indices[first:] >= 50).all()
        assert torch.equal(batch.observation[first:, 0], batch.reward[first:])
        if shown:
            assert batch.weight[first:].unique().numel() == 1
            assert float(batch.weight[-1]) == pytest.approx(float(batch.weight[:first].mean()))
        assert int((replay.sample_uniform().observation[:, 0] < 0).sum()) == shown
        replay.update_priority(batch.indices, torch.ones(40))
    assert (replay.sample_demonstrations().observation < 0).all()
    replay.close()


def test_demonstrations_are_never_replaced_and_come_back_with_a_checkpoint(tmp_path: Path) -> None:
    replay, again = filled(tmp_path / "replay"), Replay(ReplayConfig(capacity=50), 3, 2, 40, tmp_path / "again")
    replay.add([transition(7)] * 130)
    assert set(replay.sample(1.0).observation[:, 0].tolist()) == {7.0, -1.0, -2.0}
    state = {name: tensor.clone() for name, tensor in replay.state().items()}
    again.load_state(state)
    assert again.demonstrations == 2
    assert torch.equal(replay.sample(0.5).observation, again.sample(0.5).observation)
    third = Replay(ReplayConfig(capacity=50), 3, 2, 40, tmp_path / "third")
    with pytest.raises(MissingFileError, match="demonstrations has the shape"):
        third.load_state(state | {"demonstrations": state["demonstrations"][:, 1:]})
    for memory in (replay, again, third):
        memory.close()


def test_the_actor_is_cloned_when_the_warm_up_is_over(envs: AsyncVectorEnv, tmp_path: Path) -> None:
    trainer = Trainer(config(tmp_path), envs, tmp_path)
    demonstrate(trainer)
    shown = trainer.replay.sample_demonstrations()

    def distance() -> float:
        return float((torch.from_numpy(trainer.agent.act(shown.observation.numpy())) - shown.action).square().mean())

    spent = trainer.env_steps
    assert spent == trainer.demonstrations.env_steps >= STEPS
    train(trainer, spent + 100)
    untrained = distance()
    assert trainer.agent.updates == 0
    train(trainer, spent + 104)
    assert distance() < 0.5 * untrained
    trainer.replay.close()


def test_the_average_that_is_kept_follows_the_actor_that_is_cloned(envs: AsyncVectorEnv, tmp_path: Path) -> None:
    made = config(tmp_path)
    made.learner.policy_average = 20
    trainer = Trainer(made, envs, tmp_path)
    demonstrate(trainer)
    train(trainer, trainer.env_steps + 104)
    shown = trainer.replay.sample_demonstrations()
    with torch.no_grad():
        kept = (trainer.agent.policy()(shown.observation) - shown.action).square().mean()
        cloned = (trainer.agent.actor(trainer.agent.norm(shown.observation)) - shown.action).square().mean()
    assert kept < 1.5 * cloned
    trainer.replay.close()


def test_the_pull_of_demonstrations_falls_to_nothing(envs: AsyncVectorEnv, tmp_path: Path) -> None:
    made = config(tmp_path)
    made.learner.clone_updates = 100
    trainer = Trainer(made, envs, tmp_path)
    demonstrate(trainer)
    batch = trainer.replay.sample_demonstrations()
    losses = []
    for updates in (0, 50, 100, 500):
        agent = trainer.agent
        agent.updates = updates
        agent.actor_optimiser.param_groups[0]["lr"] = 0.0  # the same actor each time
        losses.append(agent.update_actor(batch, batch)["actor_loss"])
    pulls = [loss - losses[-1] for loss in losses]
    assert pulls[0] > 0 and pulls[1] == pytest.approx(pulls[0] / 2, rel=1e-3) and pulls[2] == pytest.approx(0, abs=1e-7)
    trainer.replay.close()


def test_a_run_with_demonstrations_resumes_bit_for_bit(envs: AsyncVectorEnv, tmp_path: Path) -> None:
    (tmp_path / "whole").mkdir()
    whole = Trainer(config(tmp_path / "whole"), envs, tmp_path / "whole")
    demonstrate(whole)
    first = whole.env_steps + 60
    train(whole, first)  # in the warm-up: the actor is not cloned yet
    whole.save()
    shutil.copytree(tmp_path / "whole" / "checkpoints", tmp_path / "again" / "checkpoints")
    train(whole, first + 160)
    whole.save()
    shutil.copytree(tmp_path / "whole" / "checkpoints", tmp_path / "later" / "checkpoints")
    train(whole, first + 240)
    wanted = whole.agent.state_dict()
    whole.replay.close()
    for name, pauses in (("again", (first + 160, first + 240)), ("later", (first + 240,))):
        run = tmp_path / name
        resumed = Trainer(config(run, resume=True), envs, run)
        demonstrate(resumed)  # they are in the checkpoint
        assert resumed.demonstrations.cost == whole.demonstrations.cost
        for until in pauses:
            train(resumed, until)
        found = resumed.agent.state_dict()
        assert all(torch.equal(found[key], wanted[key]) for key in wanted), name
        resumed.replay.close()
    with pytest.raises(UserError, match="is damaged in its demonstrations"):
        Trainer(config(tmp_path / "later", count=0, resume=True), envs, tmp_path / "later")


def test_networks_that_start_anew_are_cloned_again(envs: AsyncVectorEnv, tmp_path: Path) -> None:
    made = config(tmp_path, log_every=50)
    made.learner.reset_after, made.learner.reset_updates = 150, 0
    trainer = Trainer(made, envs, tmp_path)
    demonstrate(trainer)
    calls: list[int] = []
    clone = trainer.agent.clone
    trainer.agent.clone = lambda replay: calls.append(trainer.env_steps) or clone(replay)
    trainer._monitor.end_episode = lambda *_: None  # nothing is ever a success
    train(trainer, trainer.env_steps + 260)
    assert len(calls) == 400 and len(set(calls)) == 2
    trainer.replay.close()


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("demonstrated") / "run"
    assert cli.main(["train-rl", "--out", str(out), *COMMAND]) == 0
    return out


def test_every_success_rate_says_with_how_many_demonstrations(
    run: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    summary = json.loads((run / "summary.json").read_text())
    cost = summary["demonstrations"]
    assert cost == {"episodes": 1, "tries": cost["tries"], "env_steps": cost["tries"] * STEPS, "in_env_steps": True}
    assert summary["env_steps"] >= STEPS + 80 and all(e["demonstrations"] == 1 for e in summary["evaluations"])
    assert json.loads((run / "policy.json").read_text())["demonstrations"] == 1
    out = tmp_path / "evaluation"
    assert cli.main(["evaluate", "--run", str(run), "--out", str(out), "--episodes", "2"]) == 0
    assert json.loads((out / "summary.json").read_text())["demonstrations"] == 1
    assert cli.main(["report", "--agent", str(run), "--out", str(tmp_path / "page.html"), "--episodes", "1"]) == 0
    assert capsys.readouterr().out.count("with 1 demonstration") == 2
    assert cli.main(["push", str(run), "--out", str(tmp_path / "card")]) == 0
    assert "], with 1 demonstration |" in (tmp_path / "card" / "README.md").read_text()
    page = (tmp_path / "page.html").read_text()
    assert "with 1 demonstration" in page and "Trained with 1 demonstration of the task" in page


def test_a_latent_agent_takes_demonstrations_too(tiny_encoder: Path, tmp_path: Path) -> None:
    assert cli.main(["train-rl", "--encoder", str(tiny_encoder), "--out", str(tmp_path / "run"), *COMMAND]) == 0
    checkpoint = max((tmp_path / "run" / "checkpoints").iterdir())
    rows = read_tensors(checkpoint / "state.safetensors")["replay.demonstrations"]
    observation = 8 + 4 + 4  # latent, proprioception, its change
    assert rows.shape == (STEPS // 2, 2 * observation + 4 + 2)
    assert rows[:, :8].std(0).mean() > 0.01, "its latents see the drawer open"


def test_several_seeds_have_demonstrations_of_their_own(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["train-rl", "--out", str(tmp_path / "sweep"), *COMMAND, "--seeds", "0,1", "--envs", "1"]) == 0
    summary = json.loads((tmp_path / "sweep" / "summary.json").read_text())
    assert summary["demonstrations"] == 1
    assert [run["demonstrations"]["episodes"] for run in summary["runs"]] == [1, 1]
    told = capsys.readouterr().out
    assert "success at the end, with 1 demonstration: " in told and "final with 1 demonstration, 95 %" in told
    states = [max((tmp_path / "sweep" / f"seed-{seed}" / "checkpoints").iterdir()) for seed in (0, 1)]
    rows = [read_tensors(state / "state.safetensors")["replay.demonstrations"] for state in states]
    assert not torch.equal(*rows)


def test_without_demonstrations_their_keys_change_nothing(tmp_path: Path) -> None:
    keys = ["--replay.demonstration_share", "0.9", "--learner.clone_weight", "7", "--demonstration_noise", "3"]
    for name, more in (("plain", []), ("keys", keys)):
        assert cli.main(["train-rl", "--out", str(tmp_path / name), *TINY_TRAINING, "--envs", "1", *more]) == 0
    plain, other = (
        read_tensors(max((tmp_path / n / "checkpoints").iterdir()) / "state.safetensors") for n in ("plain", "keys")
    )
    assert plain.keys() == other.keys() and all(torch.equal(plain[name], other[name]) for name in plain)
    assert "demonstrations" not in (tmp_path / "plain" / "summary.json").read_text()
    assert "demonstrations" not in (tmp_path / "plain" / "policy.json").read_text()


@pytest.mark.parametrize(
    ("keys", "words"),
    [
        (
            ["--scene", "gym/Reacher-v5"],
            "--demonstrations needs a scene with a scripted policy, and gym/Reacher-v5 has none; available: "
            "metaworld/TASK, for example metaworld/drawer-open-v3",
        ),
        (["--algo", "ppo"], "--demonstrations is for --algo ddpg; ppo of Stable-Baselines3 takes none"),
        (["--algo", "without_clone:Agent"], "'without_clone:Agent' is no algorithm: it lacks clone"),
        (["--demonstrations", "-1"], "--demonstrations must be at least 0, got -1"),
        (["--replay.demonstration_share", "1"], "--replay.demonstration_share must be in [0, 1), got 1.0"),
        (["--env_steps", "2500"], "--demonstrations 3 of 200 steps each and --warmup_steps 2000 leave nothing of"),
        (["--learner.clone_weight", "-1"], "--learner.clone_weight must be in [0, 1000000], got -1.0"),
    ],
)
def test_what_cannot_have_demonstrations_is_told_in_a_sentence(
    keys: list[str],
    words: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    source = "from nerf_rl.rl.agents.ddpg import DDPG\n\n\nclass Agent(DDPG):\n    clone = None\n"
    (tmp_path / "without_clone.py").write_text(source)
    monkeypatch.syspath_prepend(str(tmp_path))
    assert cli.main(["train-rl", "--out", str(tmp_path / "run"), "--demonstrations", "3", *keys]) == 2
    assert words in capsys.readouterr().err
    assert not (tmp_path / "run").exists()


def test_panda_reach_has_no_script(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    pytest.importorskip("panda_gym", exc_type=ImportError)
    command = ["train-rl", "--scene", "panda/reach", "--episode_steps", "50", "--demonstrations", "3"]
    assert cli.main([*command, "--out", str(tmp_path / "run")]) == 2
    assert "and panda/reach has none; available: metaworld/TASK" in capsys.readouterr().err


def test_demonstrations_that_take_all_steps_are_told(envs: AsyncVectorEnv, tmp_path: Path) -> None:
    made = dataclasses.replace(config(tmp_path), env_steps=300, warmup_steps=100, demonstrations=1)
    made.demonstrations = 2  # as if a try had failed
    trainer = Trainer(made, envs, tmp_path)
    with pytest.raises(
        FailureError, match=r"took \d+ tries and \d+ env steps, which leaves nothing of --env_steps 300"
    ):
        demonstrate(trainer)
    trainer.replay.close()
