"""Measure the learner of train-rl alone beside CleanRL's DDPG: updates per second, on one thread, taking turns.

Run from a checkout's root (extra sb3, whose replay memory CleanRL uses), with nothing else running or something that
runs all the time; it writes rl/results/learner.json and the table in docs/results/agents.md, in a few minutes:

    .venv/bin/python -m tools.bench.rl

``CleanRLUpdate`` does what an update of CleanRL's ``ddpg_continuous_action.py`` does, with its sizes, optimiser,
memory and frequencies, in words of its own. Ours is measured at those sizes, without what CleanRL's has not, and as the
recipe has it. Operations are counted by PyTorch.
"""

import argparse
import dataclasses
import importlib.metadata
import statistics
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import torch
from stable_baselines3.common.buffers import ReplayBuffer
from torch import nn
from torch.nn import functional
from torch.utils.flop_counter import FlopCounterMode

from nerf_rl.arguments.parsing import parse_config
from nerf_rl.files.json_files import write_json
from nerf_rl.files.versions import git_revision, package_versions, processor
from nerf_rl.rl.agents.ddpg import DDPG
from nerf_rl.rl.config import LearnerConfig, NetworkConfig, ReplayConfig, TrainRLConfig
from nerf_rl.rl.experience.n_step import Transition
from nerf_rl.rl.experience.replay import Replay
from tools.page_tables import AGENTS_PAGE, markdown_table, write_tables

RESULT, RECIPE = Path("rl/results/learner.json"), "rl/drawer-open.yaml"
STATE, LATENTS, ACTION = 39, 128 + 4, 4  # numbers that an agent of drawer-open observes, and that it answers
TRANSITIONS = 5_000
CLEANRL, SAME, OURS = "CleanRL's DDPG", "ours, CleanRL's sizes", "ours, the recipe"
Update = Callable[[], object]


class CleanRLUpdate:
    """An update of CleanRL's DDPG: two layers of 256 each, every second time the actor and the targets, too."""

    def __init__(self, observation_size: int, batch_size: int):
        box = gymnasium.spaces.Box(-1.0, 1.0, (ACTION,), np.float32)
        seen = gymnasium.spaces.Box(-np.inf, np.inf, (observation_size,), np.float32)
        self._memory = ReplayBuffer(TRANSITIONS, seen, box, "cpu", handle_timeout_termination=False)
        for step in transitions(observation_size):
            self._memory.add(
                step.observation, step.next_observation, step.action, np.array([step.reward]), np.array([0.0]), [{}]
            )
        self._actor, self._slow_actor = (layers(observation_size, ACTION, nn.Tanh()) for _ in range(2))
        self._critic, self._slow_critic = (layers(observation_size + ACTION, 1, nn.Identity()) for _ in range(2))
        self._optimisers = [torch.optim.Adam(each.parameters(), lr=3e-4) for each in (self._actor, self._critic)]
        self._batch_size, self._updates = batch_size, 0

    def __call__(self) -> None:
        """Learn from a batch."""
        data = self._memory.sample(self._batch_size)
        with torch.no_grad():
            following = torch.cat([data.next_observations, self._slow_actor(data.next_observations)], 1)
            alive = 1 - data.dones.flatten()
            target = data.rewards.flatten() + alive * 0.99 * self._slow_critic(following).view(-1)
        value = self._critic(torch.cat([data.observations, data.actions], 1)).view(-1)
        self._descend(functional.mse_loss(value, target), self._optimisers[1])
        self._updates += 1
        if self._updates % 2:
            return
        acted = torch.cat([data.observations, self._actor(data.observations)], 1)
        self._descend(-self._critic(acted).mean(), self._optimisers[0])
        for fast, slow in ((self._actor, self._slow_actor), (self._critic, self._slow_critic)):
            for new, old in zip(fast.parameters(), slow.parameters(), strict=True):
                old.data.copy_(0.005 * new.data + 0.995 * old.data)

    @staticmethod
    def _descend(loss: torch.Tensor, optimiser: torch.optim.Optimizer) -> None:
        optimiser.zero_grad()
        loss.backward()
        optimiser.step()


def main() -> None:
    """Measure, print and write."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rounds", type=int, default=20, help="turns of each")
    parser.add_argument("--updates", type=int, default=100, help="in a turn")
    arguments = parser.parse_args()
    torch.set_num_threads(1)
    rows = [
        row
        for batch_size in (128, 256)
        for eyes, size in (("state", STATE), ("latents", LATENTS))
        for row in measure(eyes, size, batch_size, arguments)
    ]
    result = {
        "command": " ".join(["python -m tools.bench.rl", *sys.argv[1:]]),
        "git_revision": git_revision(),
        "packages": {**package_versions(), "stable-baselines3": importlib.metadata.version("stable-baselines3")},
        "processor": processor(),
        "rows": rows,
    }
    write_json(RESULT, result)
    write_tables(AGENTS_PAGE, {"learner": table(rows)})
    print(table(rows))


def measure(eyes: str, observation_size: int, batch_size: int, arguments: argparse.Namespace) -> list[dict[str, Any]]:
    """Return a row for each learner, with medians over the turns."""
    torch.manual_seed(0)
    with tempfile.TemporaryDirectory() as folder:
        plain = NetworkConfig(hidden=[256, 256], normalisation="none", standardise=False)
        same = LearnerConfig(
            batch_size=batch_size, actor_every=2, actor_batch="prioritised", tau=0.005, gamma=0.99, n_step=1
        )
        recipe = parse_config(TrainRLConfig, "train-rl", "", ["--config", RECIPE, "--out", "out"])
        learner = dataclasses.replace(recipe.learner, batch_size=batch_size)
        updates: dict[str, Update] = {
            CLEANRL: CleanRLUpdate(observation_size, batch_size),
            SAME: ours(observation_size, plain, same, ReplayConfig(prioritised=False), Path(folder) / "same"),
            OURS: ours(observation_size, recipe.network, learner, recipe.replay, Path(folder) / "recipe"),
        }
        operations = {name: count_operations(update) for name, update in updates.items()}
        seconds: dict[str, list[float]] = {name: [] for name in updates}
        for _ in range(arguments.rounds):
            for name, update in updates.items():
                seconds[name].append(timed(update, arguments.updates))
    first, most = seconds[CLEANRL], matrix_rate(batch_size)
    return [
        {
            "eyes": eyes,
            "observation_size": observation_size,
            "batch_size": batch_size,
            "learner": name,
            "updates_per_second": round(arguments.updates / statistics.median(taken), 1),
            "mflop_per_update": round(operations[name] / 1e6, 1),
            "share_of_matrix_rate": round(arguments.updates / statistics.median(taken) * operations[name] / most, 2),
            "times_cleanrl": round(statistics.median(a / b for a, b in zip(first, taken, strict=True)), 2),
        }
        for name, taken in seconds.items()
    ]


def ours(size: int, network: NetworkConfig, learner: LearnerConfig, memory: ReplayConfig, folder: Path) -> Update:
    """Return an update of our DDPG on a memory of its own."""
    agent = DDPG(size, ACTION, network, learner)
    bounded = learner.n_step if learner.bound_by_returns else 0
    memory = dataclasses.replace(memory, capacity=TRANSITIONS)
    replay = Replay(memory, size, ACTION, learner.batch_size, folder, bounded_steps=bounded)
    replay.add(transitions(size))
    return lambda: agent.update(replay, 0.7)


def transitions(observation_size: int) -> list[Transition]:
    """Return random transitions."""
    rng = np.random.default_rng(0)

    def draw(size: int) -> np.ndarray:
        return rng.uniform(-1.0, 1.0, size).astype(np.float32)

    return [
        Transition(draw(observation_size), draw(ACTION), float(rng.normal()), 0.97, draw(observation_size))
        for _ in range(TRANSITIONS)
    ]


def layers(inputs: int, outputs: int, last: nn.Module) -> nn.Sequential:
    """Return a network with two hidden layers of 256."""
    return nn.Sequential(
        nn.Linear(inputs, 256), nn.ReLU(), nn.Linear(256, 256), nn.ReLU(), nn.Linear(256, outputs), last
    )


def count_operations(update: Update) -> float:
    """Return the floating-point operations of matrix products in an update, as a mean over two."""
    update()
    update()
    with FlopCounterMode(display=False) as counter:
        update()
        update()
    return counter.get_total_flops() / 2


def matrix_rate(batch_size: int) -> float:
    """Return the floating-point operations per second of a hidden layer's matrix product alone."""
    left, right = torch.randn(batch_size, 256), torch.randn(256, 256)
    rates = [2 * batch_size * 256**2 * 100 / timed(lambda: left @ right, 100) for _ in range(30)]
    return statistics.median(rates)


def timed(update: Update, count: int) -> float:
    """Return the seconds that so many updates take."""
    start = time.perf_counter()
    for _ in range(count):
        update()
    return time.perf_counter() - start


def table(rows: list[dict[str, Any]]) -> str:
    """Return a row for each learner."""
    header = [
        "observes",
        "batch",
        "learner",
        "updates/s",
        "times CleanRL's",
        "MFLOP an update",
        "of the rate of a matrix product",
    ]
    return markdown_table(
        header,
        [
            [
                f"{row['eyes']}, {row['observation_size']}",
                str(row["batch_size"]),
                row["learner"],
                f"{row['updates_per_second']:.0f}",
                f"{row['times_cleanrl']:.2f}",
                f"{row['mflop_per_update']:.0f}",
                f"{row['share_of_matrix_rate']:.0%}",
            ]
            for row in rows
        ],
    )


if __name__ == "__main__":
    main()
