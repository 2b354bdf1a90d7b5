"""An algorithm of the user's own, in one file outside the package."""

import csv
from pathlib import Path

import pytest
from tiny_recipes import TINY_TRAINING

from nerf_rl import cli
from nerf_rl.files.tensor_files import read_tensors

TD3 = '''
"""Target policy smoothing (Fujimoto et al. 2018, section 5.3) on this project's DDPG."""

import torch

from nerf_rl.rl.agents.ddpg import DDPG, Metrics


class Smoothed(DDPG):
    def update_critic(self, batch):
        noise = (0.2 * torch.randn_like(batch.action)).clamp(-0.5, 0.5)
        plain = self.target_actor.forward
        self.target_actor.forward = lambda observation: (plain(observation) + noise).clamp(-1.0, 1.0)
        try:
            metrics, error = super().update_critic(batch)
        finally:
            self.target_actor.forward = plain
        return metrics | {"smoothing": float(noise.abs().mean())}, error


class Empty:
    pass


class Failing(DDPG):
    def __init__(self, *arguments):
        raise ValueError("no such width")
'''


@pytest.fixture
def own(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    (tmp_path / "own_td3.py").write_text(TD3)
    monkeypatch.syspath_prepend(str(tmp_path))
    return tmp_path


def train(out: Path, algorithm: str, *keys: str) -> int:
    command = ["train-rl", "--encoder", "none", "--algo", algorithm, "--checkpoint_every", "40", "--out", str(out)]
    return cli.main([*command, *TINY_TRAINING, *keys])


def test_it_trains_is_evaluated_and_resumes(own: Path) -> None:
    assert train(own / "whole", "own_td3:Smoothed") == 0
    with open(own / "whole" / "metrics.csv", newline="") as file:
        assert float(list(csv.DictReader(file))[-1]["critic_loss"]) >= 0
    assert cli.main(["evaluate", "--run", str(own / "whole"), "--out", str(own / "eval"), "--episodes", "2"]) == 0
    assert train(own / "parts", "own_td3:Smoothed", "--env_steps", "42") == 0
    assert train(own / "parts", "own_td3:Smoothed", "--resume", "true") == 0
    assert train(own / "plain", "ddpg") == 0
    weights = [read_tensors(own / run / "policy.safetensors") for run in ("whole", "plain")]
    assert any((weights[0][name] != weights[1][name]).any() for name in weights[0])


@pytest.mark.parametrize(
    ("name", "sentence"),
    [
        ("own_td3:Empty", "'own_td3:Empty' is no algorithm: it lacks act, update_statistics, update"),
        ("own_td3:Failing", "algorithm 'own_td3:Failing' cannot be had: ValueError: no such width"),
        ("nowhere:Agent", "algorithm 'nowhere:Agent' cannot be had: ModuleNotFoundError: No module named 'nowhere'"),
        ("td3", "unknown algorithm 'td3' (did you mean sb3-td3?); available: ddpg, ppo, sb3-ddpg"),
    ],
)
def test_what_is_no_algorithm_is_told(own: Path, name: str, sentence: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert train(own / "run", name) == 2
    assert sentence in capsys.readouterr().err
