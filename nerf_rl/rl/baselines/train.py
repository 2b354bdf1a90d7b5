"""Training of a Stable-Baselines3 model, evaluated and recorded as our own agents are."""

import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import torch
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.logger import Logger
from stable_baselines3.common.vec_env import DummyVecEnv, SubprocVecEnv, VecEnv, VecNormalize

from nerf_rl.loggers import make_loggers
from nerf_rl.machine.devices import resolve_device
from nerf_rl.progress import Progress
from nerf_rl.rl.baselines.models import CLIPPED_AT, export_actor, make_model
from nerf_rl.rl.config import OFF_POLICY_BASELINES, TrainRLConfig
from nerf_rl.rl.environments.make import EnvSpec, env_maker, worker_start_method
from nerf_rl.rl.environments.vector import told
from nerf_rl.rl.training.curves import MetricsLog
from nerf_rl.rl.training.episodes import evaluation_seeds, run_episodes, training_seed
from nerf_rl.rl.training.evaluation_results import DUE, due
from nerf_rl.rl.training.zoo_files import ZooFiles

_LOSS = {"ppo": "train/value_loss"} | dict.fromkeys(OFF_POLICY_BASELINES, "train/critic_loss")  # in SB3's logger
_FOREVER = 2**60  # agent steps: the callback decides when training ends


class BaselineTrainer(BaseCallback):
    """Trains a model: counts environment steps and episodes, evaluates, writes metrics.csv, and ends the training.

    Args:
        config: of the run; ``algo`` is one of the baselines.
        spec: of the environments.
        evaluation_envs: with autoreset disabled.
        run: the run folder.

    Attributes:
        evaluations: results so far, as in ``summary.json``.
    """

    def __init__(self, config: TrainRLConfig, spec: EnvSpec, evaluation_envs: gymnasium.vector.VectorEnv, run: Path):
        super().__init__()
        torch.set_num_threads(config.threads)
        self._config, self._evaluation_envs = config, evaluation_envs
        self._envs = _make_envs(config, spec)
        self._sb3 = make_model(config, self._envs)
        self._sb3.set_logger(Logger(None, []))  # its own would leave a folder in the temporary one for each run
        self.metrics = MetricsLog(run / "metrics.csv", loggers=make_loggers(config.loggers, run))
        self._zoo = ZooFiles(run, config.scene)
        self._returns, self._length = np.zeros(config.envs), np.zeros(config.envs, np.int64)
        self._success, self._tells = np.zeros(config.envs, np.bool_), False
        self._last_log = 0
        self._start = time.monotonic()
        self.env_steps, self.episodes = 0, 0
        self.evaluations: list[dict[str, Any]] = []

    @property
    def seconds(self) -> float:
        """Time spent so far [s]."""
        return time.monotonic() - self._start

    @property
    def finished(self) -> bool:
        """Whether the run has had its environment steps, or its episodes."""
        return self.env_steps >= self._config.env_steps or 0 < self._config.episodes <= self.episodes

    @property
    def updates(self) -> int:
        """Gradient steps so far; for PPO, passes over collected data."""
        return int(self._sb3._n_updates)

    def train(self, after_evaluation: Callable[[dict[str, Any], Progress], None]) -> None:
        """Train to the end; call ``after_evaluation`` with each result and the progress."""
        self._after_evaluation = after_evaluation
        cause = "by the error above, if there is one, or killed, such as for want of memory"
        with Progress(self._config.env_steps, "env steps") as self._progress, told("--resume true begins anew", cause):
            self._sb3.learn(_FOREVER, callback=self)

    def actor(self) -> torch.nn.Sequential:
        """Return the policy so far, from raw observations to actions."""
        return export_actor(self._sb3, self._config)

    @property
    def processes(self) -> list[Any]:
        """The processes of the training environments; none if they are in this one."""
        return list(getattr(self._envs.unwrapped, "processes", []))

    def close(self) -> None:
        """End the training environments, also those whose process has ended already."""
        with suppress(EOFError, OSError):
            self._envs.close()

    def _on_step(self) -> bool:
        """Take one step of all environments into account; tell Stable-Baselines3 whether to go on."""
        config, before = self._config, self.env_steps
        infos, dones = self.locals["infos"], self.locals["dones"]
        steps = np.array([info["env_steps"] for info in infos])
        normaliser = self._sb3.get_vec_normalize_env()
        self._returns += self.locals["rewards"] if normaliser is None else normaliser.get_original_reward()
        self._length += steps
        self._tells = self._tells or any("success" in info for info in infos)  # some tell of it at the end alone
        self._success |= np.array([info.get("success", False) for info in infos])
        self.env_steps += int(steps.sum())
        for env in np.flatnonzero(dones).tolist():
            self._count_episode(env)
        self._progress.advance(self.env_steps - before)
        is_due = self.finished or self.env_steps // config.evaluation_every > before // config.evaluation_every
        if self.env_steps - self._last_log >= config.log_every or is_due:
            self._log()
        if is_due:
            self._evaluate()
        return not self.finished

    def _count_episode(self, env: int) -> None:
        self.episodes += 1
        ended = {"episode_return": float(self._returns[env]), "episode_length": float(self._length[env])}
        success = bool(self._success[env]) if self._tells else None
        self._zoo.add_episode(ended["episode_return"], int(self._length[env]), self.seconds, success, self.env_steps)
        self.metrics.gather(ended | ({"episode_success": float(self._success[env])} if self._tells else {}))
        self._returns[env], self._length[env], self._success[env] = 0.0, 0, False

    def _evaluate(self) -> None:
        config, actor = self._config, self.actor()

        def act(observation: np.ndarray) -> np.ndarray:
            with torch.no_grad():
                return actor(torch.from_numpy(observation)).numpy()

        episodes = config.final_evaluation_episodes if self.finished else config.evaluation_episodes
        seeds = evaluation_seeds(0, episodes)
        found = run_episodes(self._evaluation_envs, act, seeds, config.evaluation_to_end)
        found.require_numbers(self.env_steps)
        when = {"env_steps": self.env_steps, DUE: due(self.env_steps, vars(config))}
        facts = {**when, "training_episodes": self.episodes}
        self.evaluations.append({**facts, **found.summary()})
        self._zoo.add_evaluation(self.env_steps, found)
        self.metrics.write_evaluation(self.evaluations[-1])
        self._after_evaluation(self.evaluations[-1], self._progress)

    def _log(self) -> None:
        values = self._sb3.logger.name_to_value
        if (name := _LOSS[self._config.algo]) in values:
            self.metrics.gather({"critic_loss": float(values[name])})
        self.metrics.write(env_steps=self.env_steps, seconds=self.seconds, episodes=self.episodes)
        self._last_log = self.env_steps


def _make_envs(config: TrainRLConfig, spec: EnvSpec) -> VecEnv:
    """Return seeded training environments: in this process if there is one, else each in its own."""
    makers = [env_maker(spec, str(resolve_device(config.device)))] * config.envs
    envs: VecEnv = DummyVecEnv(makers) if config.envs == 1 else SubprocVecEnv(makers, worker_start_method(spec))
    envs.seed(training_seed(config.seed, 0, 0))  # that of each next environment is one more, and so may not be a seed's
    if config.algo == "ppo" and config.ppo.normalise:
        return VecNormalize(envs, gamma=config.ppo.gamma, clip_obs=CLIPPED_AT)
    return envs
