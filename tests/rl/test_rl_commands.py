"""train-rl and evaluate from end to end: a tiny encoder, few steps, every file that they promise."""

import csv
import json
import multiprocessing
import shutil
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import pytest
import torch
from metaworld.env_dict import ALL_V3_ENVIRONMENTS_GOAL_OBSERVABLE

from nerf_rl import cli
from nerf_rl.errors import FailureError, UserError
from nerf_rl.files.outputs import write_provenance
from nerf_rl.pictures.video import write_mp4
from nerf_rl.pretrain.model.encoder import Encoder
from nerf_rl.progress import Progress
from nerf_rl.rl.agents.policy import Policy
from nerf_rl.rl.environments.make import EnvSpec, make_env
from nerf_rl.rl.environments.observation import LatentObservation
from nerf_rl.rl.rollout import film, rollout
from nerf_rl.rl.train import train_rl
from nerf_rl.rl.training.loop import Trainer
from nerf_rl.scenes.make import make_scene

SHORT = ["--env_steps", "120", "--warmup_steps", "40", "--episode_steps", "20", "--learner.batch_size", "8"]
SHORT += ["--evaluation_every", "80", "--evaluation_episodes", "2", "--final_evaluation_episodes", "3", "--envs", "2"]
SHORT += ["--replay.capacity", "500", "--network.hidden", "[16, 16]"]


@pytest.fixture(scope="module")
def run(tiny_encoder: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("rl") / "agent"
    assert cli.main(["train-rl", "--encoder", str(tiny_encoder), "--out", str(out), *SHORT]) == 0
    return out


def test_a_run_that_had_ended_and_goes_on_is_told_of_by_no_older_summary(
    run: Path, tiny_encoder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    out = Path(shutil.copytree(run, tmp_path / "agent"))
    words = ["train-rl", "--encoder", str(tiny_encoder), "--out", str(out), *SHORT]
    words += ["--env_steps", "240", "--resume", "true"]
    with monkeypatch.context() as killed:
        killed.setattr(Trainer, "save", lambda self: (_ for _ in ()).throw(KeyboardInterrupt))
        assert cli.main(words) == 130
    assert Policy.load(out).env_steps > 120 and not (out / "summary.json").exists()
    assert cli.main(words) == 0
    evaluations = json.loads((out / "summary.json").read_text())["evaluations"]
    assert [evaluation["env_steps"] for evaluation in evaluations] == [80, 120, 160, 240]


def test_training_leaves_what_it_promises(run: Path) -> None:
    names = {path.name for path in run.iterdir()}
    assert names == {
        "config.yaml",
        "provenance.json",
        "summary.json",
        "metrics.csv",
        "monitor.csv",
        "evaluations.npz",
        "learning_curve.png",
        "policy.json",
        "policy.safetensors",
        "checkpoints",
        "logs",
    }
    summary = json.loads((run / "summary.json").read_text())
    assert summary["env_steps"] == 120
    assert [(e["env_steps"], e["episodes"]) for e in summary["evaluations"]] == [(80, 2), (120, 3)]
    assert {"success_rate", "ci_low", "ci_high", "mean_return"} <= set(summary["evaluations"][0])
    with open(run / "metrics.csv", newline="") as file:
        rows = list(csv.DictReader(file))
    assert rows[-1]["env_steps"] == "120" and float(rows[-1]["critic_loss"]) >= 0


def test_evaluation_writes_its_summary_and_a_video(run: Path, tmp_path: Path) -> None:
    out = tmp_path / "evaluation"
    keys = ["--episodes", "3", "--video", "true", "--video_episodes", "1", "--video_size", "64"]
    assert cli.main(["evaluate", "--run", str(run), "--out", str(out), *keys]) == 0
    summary = json.loads((out / "summary.json").read_text())
    assert summary["episodes"] == 3 and 0 <= summary["ci_low"] <= summary["success_rate"] <= summary["ci_high"] <= 1
    assert (out / "episodes.mp4").read_bytes()[4:8] == b"ftyp"


def test_a_rollout_tells_each_step(run: Path, tiny_encoder: Path) -> None:
    episode = rollout(run, seed=3, view_size=48)
    encoder = Encoder.load(tiny_encoder)
    assert episode.images is not None and episode.latents is not None
    steps = len(episode.actions)
    assert episode.images.shape == (steps + 1, 2, 24, 24, 3)
    assert episode.view.shape == (steps + 1, 48, 48, 3)
    with torch.inference_mode():
        projections = torch.as_tensor(encoder.rig.projections)[None].expand(steps + 1, -1, -1, -1)
        latents = encoder(torch.from_numpy(episode.images), projections)
    assert np.allclose(episode.latents, latents.numpy(), atol=1e-4)
    assert film(episode).shape == (steps + 1, 48, 72, 3)


def test_the_observation_is_the_standardised_latent_proprioception_and_its_change_only(tiny_encoder: Path) -> None:
    encoder = Encoder.load(tiny_encoder)
    env, scene = make_env(EnvSpec("metaworld/drawer-open-v3", str(tiny_encoder), 2, 20), encoder)
    observation, _ = env.reset(seed=1)
    assert env.observation_space.contains(observation)
    assert observation.shape == (encoder.latent_size + len(scene.proprio_names + scene.motion_names),)
    assert isinstance(env, LatentObservation)
    latent = (env.last_latent - encoder.latent_mean.numpy()) / encoder.latent_std.numpy()
    assert np.allclose(observation[: encoder.latent_size], latent, atol=1e-5)
    hand = scene.data.body("hand").xpos
    assert np.allclose(observation[encoder.latent_size :][:2], hand[:2], atol=0.02)
    assert not observation[-len(scene.motion_names) :].any()  # nothing has moved yet
    env.close()


def test_any_gymnasium_environment_with_a_mujoco_model_can_be_wrapped(tiny_encoder: Path) -> None:
    env = LatentObservation(make_scene("metaworld/drawer-open-v3").env, tiny_encoder)
    observation, _ = env.reset(seed=0)
    assert observation.shape == (8,) and observation.dtype == np.float32
    env.close()


def test_an_encoder_of_another_scene_is_refused_before_anything_is_written(
    tiny_encoder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    keys = ["--scene", "metaworld/door-open-v3", "--encoder", str(tiny_encoder), "--out", str(tmp_path / "x")]
    assert cli.main(["train-rl", *keys]) == 2
    assert (
        "the encoder was trained on scene metaworld/drawer-open-v3, not metaworld/door-open-v3"
        in capsys.readouterr().err
    )
    assert not (tmp_path / "x").exists()


def test_a_policy_comes_back_from_disk_the_same_and_knows_its_encoder(
    run: Path, tiny_encoder: Path, tmp_path: Path
) -> None:
    policy = Policy.load(run)
    policy.save(tmp_path)
    again = Policy.load(tmp_path)
    observation = np.random.default_rng(0).normal(size=(5, policy.observation_size)).astype(np.float32)
    assert np.array_equal(policy.act(observation), again.act(observation))
    known = ["hand_x", "hand_y", "hand_z", "gripper"]
    assert (again.spec, again.proprio_names) == (policy.spec, [*known, *(f"{name}_change" for name in known)])
    other = tmp_path / "other"
    other.mkdir()
    for name in ("encoder.json", "encoder.safetensors"):
        (other / name).write_bytes((tiny_encoder / name).read_bytes())
    assert Policy.load(run, str(other)).spec.encoder == str(other)
    with open(other / "encoder.safetensors", "ab") as file:
        file.write(b"\0")
    with pytest.raises(UserError, match="is not the encoder that the policy in"):
        Policy.load(run, str(other))


def test_a_policy_of_another_format_is_refused_in_a_sentence(run: Path, tmp_path: Path) -> None:
    for name in ("policy.json", "policy.safetensors"):
        (tmp_path / name).write_bytes((run / name).read_bytes())
    old = json.loads((tmp_path / "policy.json").read_text()) | {"version": 2}
    (tmp_path / "policy.json").write_text(json.dumps(old))
    with pytest.raises(UserError, match="has format 2, this version reads 3; train it again"):
        Policy.load(tmp_path)


def test_an_agent_whose_encoder_has_moved_says_how_to_name_it(
    run: Path, tiny_encoder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    agent = shutil.copytree(run, tmp_path / "agent")
    description = json.loads((agent / "policy.json").read_text())
    description["env"]["encoder"] = str(tmp_path / "gone")
    (agent / "policy.json").write_text(json.dumps(description))
    words = ["evaluate", "--run", str(agent), "--episodes", "1"]
    assert cli.main([*words, "--out", str(tmp_path / "evaluation")]) == 2
    said = f"its encoder is not at {tmp_path / 'gone'} any more; say where it is by --encoder"
    assert said in capsys.readouterr().err
    assert cli.main([*words, "--out", str(tmp_path / "evaluation"), "--encoder", str(tiny_encoder)]) == 0


def test_a_run_on_the_true_state_resumes_and_evaluates(tmp_path: Path) -> None:
    out = tmp_path / "state"
    assert cli.main(["train-rl", "--out", str(out), *SHORT, "--envs", "1", "--checkpoint_every", "60"]) == 0
    longer = ["--env_steps", "140", "--resume", "true", "--envs", "1"]
    assert cli.main(["train-rl", "--out", str(out), *SHORT, *longer]) == 0
    summary = json.loads((out / "summary.json").read_text())
    assert [e["env_steps"] for e in summary["evaluations"]] == [80, 120, 140]
    assert rollout(out, view_size=32).images is None
    assert cli.main(["train-rl", "--out", str(out), *SHORT]) == 2


def test_a_run_that_is_to_end_where_it_was_interrupted_is_evaluated_and_kept(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    keys = ["train-rl", "--out", str(tmp_path / "run"), *SHORT, "--envs", "1", "--checkpoint_every", "30"]
    train = Trainer.train

    def interrupted(self: Trainer, progress: Progress, until: int) -> None:
        if self.env_steps >= 60:
            raise KeyboardInterrupt
        train(self, progress, until)

    with monkeypatch.context() as patch:
        patch.setattr(Trainer, "train", interrupted)
        assert cli.main(keys) == 130
    assert not (tmp_path / "run/policy.json").exists()
    assert cli.main([*keys, "--env_steps", "50", "--resume", "true"]) == 0
    summary = json.loads((tmp_path / "run/summary.json").read_text())
    assert [(e["env_steps"], e["episodes"]) for e in summary["evaluations"]] == [(60, 3)]
    assert Policy.load(tmp_path / "run").env_steps == 60
    before = (tmp_path / "run/summary.json").read_text()
    assert cli.main([*keys, "--env_steps", "60", "--resume", "true"]) == 0
    after = json.loads((tmp_path / "run/summary.json").read_text())
    assert after["evaluations"] == json.loads(before)["evaluations"]  # it is not evaluated once more


@pytest.mark.parametrize("keys", [["--algo", "ppo"], ["--learner.n_step", "20", "--action_repeat", "1"]])
def test_a_run_without_an_update_says_so(keys: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    words = ["--env_steps", "64", "--episode_steps", "80", "--envs", "4"]
    assert cli.main(["train-rl", "--out", str(tmp_path / "run"), *SHORT, *words, *keys]) == 0
    assert json.loads((tmp_path / "run/summary.json").read_text())["updates"] == 0
    assert "warning: nothing was learnt in 64 env steps: there was no update" in capsys.readouterr().err


def test_a_checkpoint_of_agents_that_observed_something_else_is_not_gone_on_with(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "state"
    assert cli.main(["train-rl", "--out", str(out), *SHORT, "--envs", "1"]) == 0
    (file,) = out.glob("checkpoints/*/state.json")
    facts = json.loads(file.read_text())
    assert facts.pop("format") == 2
    file.write_text(json.dumps(facts))
    keys = [*SHORT, "--env_steps", "140", "--resume", "true", "--envs", "1"]
    assert cli.main(["train-rl", "--out", str(out), *keys]) == 2
    assert "it is of an earlier version, whose agents observed something else; begin the run" in capsys.readouterr().err


def test_a_run_is_not_gone_on_with_an_encoder_that_took_the_place_of_its_own(
    tiny_encoder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    encoder, sweep = shutil.copytree(tiny_encoder, tmp_path / "encoder"), tmp_path / "sweep"
    keys = ["train-rl", "--encoder", str(encoder), *SHORT, "--envs", "1"]
    run = sweep / "seed-0"
    assert cli.main([*keys, "--out", str(run)]) == 0
    write_provenance(sweep, "train-rl", cli.parse("train-rl", [*keys[1:], "--out", str(sweep), "--seeds", "0..0"]))
    weights = bytearray((encoder / "encoder.safetensors").read_bytes())
    weights[-1] ^= 1
    (encoder / "encoder.safetensors").write_bytes(weights)
    before = {path: path.stat().st_mtime_ns for path in sweep.rglob("*")}
    longer = ["--env_steps", "140", "--resume", "true"]
    for out in (["--out", str(run)], ["--out", str(sweep), "--seeds", "0..0"]):
        assert cli.main([*keys, *longer, *out]) == 2
        assert f"{encoder} is not the encoder that {run} was begun with" in capsys.readouterr().err
    assert {path: path.stat().st_mtime_ns for path in sweep.rglob("*")} == before
    shutil.copytree(tiny_encoder, encoder, dirs_exist_ok=True)
    (file,) = run.glob("checkpoints/*/state.json")
    facts = json.loads(file.read_text())
    assert facts.pop("encoder_digest") == json.loads((run / "policy.json").read_text())["encoder_digest"]
    file.write_text(json.dumps(facts))  # as an earlier version left it
    assert cli.main([*keys, *longer, "--out", str(run)]) == 0


def test_whoever_watches_evaluations_may_end_the_training(tmp_path: Path) -> None:
    seen: list[dict[str, Any]] = []

    def stop(evaluation: dict[str, Any]) -> None:
        seen.append(evaluation)
        raise InterruptedError("enough")

    config = cli.parse("train-rl", ["--out", str(tmp_path / "run"), *SHORT, "--envs", "1"])
    with pytest.raises(InterruptedError, match="enough"):
        train_rl(config, stop)
    assert [evaluation["env_steps"] for evaluation in seen] == [80]
    assert not multiprocessing.active_children()
    names = {path.name for path in (tmp_path / "run").iterdir()}
    assert "policy.safetensors" in names and not {"summary.json", "replay"} & names


def test_videos_of_odd_size_are_padded(tmp_path: Path) -> None:
    write_mp4(tmp_path / "x.mp4", np.zeros((3, 33, 35, 3), np.uint8), 10.0)
    assert (tmp_path / "x.mp4").stat().st_size > 500
    assert [path.name for path in tmp_path.iterdir()] == ["x.mp4"]


@pytest.mark.parametrize("several", [False, True])
def test_a_run_goes_on_with_its_encoder_wherever_that_lies_now(
    several: bool, tiny_encoder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    encoder = shutil.copytree(tiny_encoder, tmp_path / "encoder")
    keys = ["train-rl", *SHORT, "--envs", "1", "--out", str(tmp_path / "run"), *(["--seeds", "0..0"] * several)]
    assert cli.main([*keys, "--encoder", str(encoder)]) == 0
    moved = encoder.rename(tmp_path / "moved")
    longer = ["--env_steps", "140", "--resume", "true"]
    assert cli.main([*keys, "--encoder", "none", *longer]) == 2
    assert "was begun with another --encoder" in capsys.readouterr().err
    assert cli.main([*keys, "--encoder", str(moved), *longer]) == 0
    run = tmp_path / "run" / ("seed-0" if several else "")
    assert Policy.load(run).spec.encoder == str(moved) and Policy.load(run).env_steps == 140


def test_a_stock_environment_keeps_its_own_observation_space_inside(tiny_encoder: Path) -> None:
    stock = ALL_V3_ENVIRONMENTS_GOAL_OBSERVABLE["drawer-open-v3-goal-observable"](seed=0)
    env = LatentObservation(stock, tiny_encoder, proprio=lambda observation: observation[:4])
    assert isinstance(env.env.observation_space, gymnasium.spaces.Box)
    assert env.observation_space.shape == (12,)
    env.close()


def test_a_policy_whose_actions_are_no_numbers_says_so(run: Path, tmp_path: Path) -> None:
    policy = Policy.load(run)
    with torch.no_grad():
        policy.actor[0].squares.fill_(-1.0)
        policy.actor[0].mean.fill_(1e300)
    with pytest.raises(FailureError, match="the policy gives actions that are not numbers; train it, or its encoder,"):
        policy.act(np.zeros((1, policy.observation_size), np.float32))


def test_what_cannot_be_begun_does_not_cost_an_earlier_result(
    run: Path, tiny_encoder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out, evaluation = Path(shutil.copytree(run, tmp_path / "agent")), tmp_path / "evaluation"
    huge = ["train-rl", "--encoder", str(tiny_encoder), "--out", str(out), *SHORT, "--overwrite", "true"]
    before = {path: path.read_bytes() for path in out.rglob("*") if path.is_file()}
    assert cli.main([*huge, "--replay.capacity", "10000000000"]) == 2
    assert "replay memory needs" in capsys.readouterr().err
    assert {path: path.read_bytes() for path in out.rglob("*") if path.is_file()} == before
    words = ["evaluate", "--run", str(out), "--out", str(evaluation), "--episodes", "1"]
    assert cli.main(words) == 0
    told = (evaluation / "summary.json").read_bytes()
    (out / "policy.safetensors").write_bytes(b"cut off")
    assert cli.main([*words, "--overwrite", "true"]) == 2
    assert (evaluation / "summary.json").read_bytes() == told


@pytest.mark.parametrize(("asked", "told"), [(1, 2), (3, 3)], ids=["evaluated already", "in fewer episodes"])
def test_a_run_that_is_to_end_at_its_checkpoint_keeps_the_policy_of_then(
    asked: int, told: int, tiny_encoder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    out = tmp_path / "agent"
    words = ["train-rl", "--encoder", str(tiny_encoder), "--out", str(out), *SHORT, "--checkpoint_every", "80"]
    saved, save = [], Trainer.save

    def save_once(self: Trainer) -> None:
        if saved:
            raise KeyboardInterrupt
        saved.append(self.env_steps)
        save(self)

    with monkeypatch.context() as killed:
        killed.setattr(Trainer, "save", save_once)
        assert cli.main(words) == 130
    assert saved == [80] and Policy.load(out).env_steps == 120
    keys = ["--env_steps", "80", "--final_evaluation_episodes", str(asked)]
    assert cli.main([*words, *keys, "--resume", "true"]) == 0
    (last,) = json.loads((out / "summary.json").read_text())["evaluations"]
    assert Policy.load(out).env_steps == last["env_steps"] == 80 and last["episodes"] == told
    with np.load(out / "evaluations.npz") as drawn:
        assert drawn["timesteps"].tolist() == [80] and drawn["results"].shape == (1, told)
