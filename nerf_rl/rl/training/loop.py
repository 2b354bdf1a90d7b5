"""The training loop: workers step and render while the learner updates."""

import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import torch
from jaxtyping import Float
from numpy import ndarray

from nerf_rl.errors import DivergedError, UserError
from nerf_rl.files.tensor_files import require_tensors, strip_prefix
from nerf_rl.loggers import make_loggers
from nerf_rl.machine.devices import resolve_device
from nerf_rl.progress import Progress
from nerf_rl.rl.agents.agent import ValuingAgent, make_agent
from nerf_rl.rl.agents.policy import act
from nerf_rl.rl.agents.policy_file import encoder_digest
from nerf_rl.rl.config import NO_ENCODER, TrainRLConfig
from nerf_rl.rl.environments.goals import ACHIEVED, GoalTask
from nerf_rl.rl.environments.vector import begin_step, finish_step, reset_some
from nerf_rl.rl.experience.hindsight import Hindsight
from nerf_rl.rl.experience.n_step import NStep
from nerf_rl.rl.experience.noise import linear_schedule
from nerf_rl.rl.experience.replay import Replay
from nerf_rl.rl.experience.replay_chunks import count_rows, load_rows, most_rows, save_rows
from nerf_rl.rl.training.checkpoint import (
    last_checkpoint,
    load_checkpoint,
    require_same_observations,
    save_checkpoint,
)
from nerf_rl.rl.training.curriculum import Curriculum
from nerf_rl.rl.training.curves import MetricsLog
from nerf_rl.rl.training.deadlock import DeadlockMonitor
from nerf_rl.rl.training.demonstrated_start import DemonstratedStart
from nerf_rl.rl.training.echoes import REMEMBERED, Echoes
from nerf_rl.rl.training.episodes import evaluation_seeds, run_episodes
from nerf_rl.rl.training.evaluation_results import DEMONSTRATIONS, DUE, due
from nerf_rl.rl.training.exploration import Exploration
from nerf_rl.rl.training.learnt_reward import learnt_reward
from nerf_rl.rl.training.zoo_files import ZooFiles


class Trainer:
    """Trains an agent on parallel environments.

    Episodes are broken off (as truncations) at every evaluation and checkpoint, and new ones are started. All that a
    checkpoint has to hold is thereby in this process, and a resumed run repeats the uninterrupted one exactly. What had
    succeeded by then counts as a success; what had not, as nothing.

    Args:
        config: of the run.
        envs: with autoreset disabled, actions in [-1, 1].
        run: the run folder.
        goal_task: for hindsight relabelling; without one there is none.

    Attributes:
        episodes: training episodes that have ended or were broken off.
        evaluations: results so far, as in ``summary.json``.
        demonstrations: that the run begins with, if any.
    """

    def __init__(
        self, config: TrainRLConfig, envs: gymnasium.vector.VectorEnv, run: Path, goal_task: GoalTask | None = None
    ):
        self._config, self._envs, self._run = config, envs, run
        torch.set_num_threads(config.threads)
        torch.manual_seed(config.seed)
        self._rng = np.random.default_rng([config.seed, 0])
        count, learner = envs.num_envs, config.learner
        self.observation_size = int(np.prod(envs.single_observation_space.shape or ()))
        self.action_size = int(np.prod(envs.single_action_space.shape or ()))
        self.agent = make_agent(config, self.observation_size, self.action_size, resolve_device(config.device))
        self._checkpoint = last_checkpoint(run) if config.resume else None
        sizes = (self.observation_size, self.action_size, learner.batch_size)
        bounded = (learner.n_step if learner.uses_returns else 0, learner.steady_ends)
        self.replay = Replay(
            config.replay, *sizes, run / "replay", config.seed, self._checkpoint_rows(), count, *bounded
        )
        self._exploration = Exploration(config, count, self.action_size, self._rng)
        self._n_steps = [NStep(learner.n_step, learner.gamma) for _ in range(count)]
        self._hindsight = self._make_hindsight(goal_task)
        self._length = np.zeros(count, np.int64)
        self._returns, self._success, self._tells = np.zeros(count), np.zeros(count, np.bool_), False
        eased = (config.retry_share, config.steps_after_success)
        self._curriculum = Curriculum(config.seed, count, *eased, self._rng, config.echo_share)
        self._echoes = Echoes(count, REMEMBERED if config.echo_share else 0, self._rng)
        self.env_steps, self.episodes, self._credit = 0, 0, 0.0
        self._seconds_before, self._start = 0.0, time.monotonic()
        self.evaluations: list[dict[str, Any]] = []
        self._monitor = DeadlockMonitor()
        self.demonstrations = DemonstratedStart(config)
        self._encoder_digest = None if config.encoder == NO_ENCODER else encoder_digest(config.encoder)
        if self._checkpoint is not None:
            self._load(self._checkpoint)
        self.metrics = MetricsLog(
            run / "metrics.csv", self.env_steps, make_loggers(config.loggers, run, self.env_steps)
        )
        self._zoo = ZooFiles(run, config.scene, self.env_steps)

    @property
    def seconds(self) -> float:
        """Time spent so far, including that before an interruption [s]."""
        return self._seconds_before + time.monotonic() - self._start

    @property
    def finished(self) -> bool:
        """Whether the run has had its environment steps, or its episodes."""
        config = self._config
        return self.env_steps >= config.env_steps or 0 < config.episodes <= self.episodes

    @property
    def _acted(self) -> int:
        """Environment steps that the agent itself has had."""
        return self.env_steps - self.demonstrations.env_steps

    def demonstrate(self, progress: Progress) -> None:
        """Have the demonstrations acted that the run asks for, unless a checkpoint held them.

        Args:
            progress: advanced by their environment steps, which are part of the run's.

        Raises:
            FailureError: the script hardly ever succeeds, or takes all of the run's environment steps.
        """
        if told := self.demonstrations.act(self._envs, self.agent, self.replay):
            self.env_steps = self.demonstrations.env_steps
            self._exploration.begin(self.env_steps)
            self._monitor.forgive(self.env_steps)
            progress.advance(self.env_steps)
            progress.say(told)

    def train(self, progress: Progress, until: int) -> None:
        """Go on until ``until`` environment steps are done or the run is finished; then the episodes are broken off.

        Args:
            progress: advanced by environment steps.
        """
        self._react(progress)
        observation = self._restart(np.ones(self._envs.num_envs, np.bool_))
        last_log, last_updates, last_seconds = self.env_steps, self.agent.updates, self.seconds
        while self.env_steps < until and not self.finished:
            before = self.env_steps
            observation = self._step(observation)
            progress.advance(self.env_steps - before)
            is_over = self.env_steps >= until or self.finished
            if self.env_steps - last_log >= self._config.log_every or is_over:
                rate = (self.agent.updates - last_updates) / max(self.seconds - last_seconds, 1e-9)
                self._log(rate)
                if not is_over:  # fresh networks, which have learnt nothing yet, are neither evaluated nor kept
                    self._react(progress)
                last_log, last_updates, last_seconds = self.env_steps, self.agent.updates, self.seconds
        for env, n_step in enumerate(self._n_steps):
            self.replay.add(n_step.cut(), env)
            self.replay.end_episode(env, self._value())
            if self._success[env]:
                self._learn_of_end(env, True)
            else:
                self._curriculum.break_off(env)
        for hindsight in self._hindsight:
            self.replay.add(hindsight.cut())
        self.episodes += int((self._length > 0).sum())

    def evaluate(self, episodes: int) -> dict[str, Any]:
        """Run evaluation episodes with the policy that is kept; return the result, and keep it in place of one of now.

        Raises:
            DivergedError: a return or an action is no number.
        """
        seeds = evaluation_seeds(0, episodes)
        found = run_episodes(self._envs, partial(act, self.agent.policy()), seeds, self._config.evaluation_to_end)
        found.require_numbers(self.env_steps)
        told = {DEMONSTRATIONS: self._config.demonstrations} if self._config.demonstrations else {}
        when = {"env_steps": self.env_steps, DUE: due(self.env_steps, vars(self._config))}
        facts = {**when, "training_episodes": self.episodes, **told}
        before = [evaluation for evaluation in self.evaluations if evaluation["env_steps"] < self.env_steps]
        self.evaluations = [*before, {**facts, **found.summary()}]
        self._zoo.add_evaluation(self.env_steps, found)
        self.metrics.write_evaluation(self.evaluations[-1])
        return self.evaluations[-1]

    def is_evaluated(self, episodes: int) -> bool:
        """Tell whether the agent, as it is now, has been evaluated in so many episodes or more."""
        last = self.evaluations[-1:]
        return any(each["env_steps"] == self.env_steps and each["episodes"] >= episodes for each in last)

    def save(self) -> None:
        """Write a checkpoint; call it only between two calls of :meth:`train`.

        Raises:
            DivergedError: the agent holds what is no number, of which nobody could go on; the last checkpoint stays.
        """
        tensors = {f"agent.{name}": tensor for name, tensor in self.agent.state_dict().items()}
        if not all(bool(torch.isfinite(tensor).all()) for tensor in tensors.values()):
            raise DivergedError(self.env_steps, "a weight of the agent")
        tensors |= {f"replay.{name}": tensor for name, tensor in self.replay.bookkeeping().items()}
        tensors |= {f"echo.{name}": tensor for name, tensor in self._echoes.state_dict().items()}
        tensors["torch_rng"] = torch.get_rng_state()
        facts = {
            "env_steps": self.env_steps,
            "updates": self.agent.updates,
            "episodes": self.episodes,
            "credit": self._credit,
            **self._curriculum.state_dict(),
            "seconds": self.seconds,
            "tells_success": self._tells,
            "encoder_digest": self._encoder_digest,
            "rng": self._rng.bit_generator.state,
            "evaluations": self.evaluations,
            "monitor": self._monitor.state_dict(),
            **self._exploration.state_dict(),
            **self.demonstrations.state_dict(),
        }
        before = self._checkpoint
        self._checkpoint = save_checkpoint(
            self._run, self.env_steps, tensors, facts, lambda folder: save_rows(self.replay, folder, before)
        )

    def _load(self, checkpoint: Path) -> None:
        tensors, facts = load_checkpoint(checkpoint)
        require_same_observations(facts, self._config.scene, checkpoint)
        if len(facts["episode_index"]) != self._envs.num_envs:
            raise UserError(f"{checkpoint} is of a run with {len(facts['episode_index'])} --envs")
        self.agent.load_state_dict(strip_prefix(tensors, "agent"), checkpoint)
        random_state = {name: tensor for name, tensor in tensors.items() if name == "torch_rng"}
        require_tensors(random_state, {"torch_rng": torch.get_rng_state()}, checkpoint)
        damaged = UserError(
            f"{checkpoint} is damaged, or of another version of nerf-rl; train again with --overwrite true"
        )
        try:
            torch.set_rng_state(random_state["torch_rng"])
        except RuntimeError as error:  # a state that the generator cannot be in
            raise damaged from error
        replay = strip_prefix(tensors, "replay")
        if "stored" not in replay or replay["stored"].numel() != 1 or int(replay["stored"]) < 1:
            raise damaged
        stored = int(replay["stored"])
        oldest = max(0, stored - self._config.replay.capacity)
        self.replay.load_state(replay | {"rows": load_rows(checkpoint, oldest, stored)}, checkpoint)
        self.env_steps, self.agent.updates, self.episodes = facts["env_steps"], facts["updates"], facts["episodes"]
        self._credit, self._seconds_before, self.evaluations = facts["credit"], facts["seconds"], facts["evaluations"]
        self._tells = facts.get("tells_success", False)
        self._curriculum.load_state_dict(facts)
        sizes = (self.observation_size, self.action_size)
        self._echoes.load_state_dict(strip_prefix(tensors, "echo"), sizes, checkpoint)
        self._rng.bit_generator.state = facts["rng"]
        self._monitor.load_state_dict(facts["monitor"])
        self._exploration.load_state_dict(facts)
        self.demonstrations.load_state_dict(facts, self.replay, checkpoint)

    def _checkpoint_rows(self) -> int:
        """Return about how many rows of replay memory checkpoints will hold, beyond those that they hold already."""
        config = self._config
        rows_per_step = (1 + config.replay.hindsight) / config.action_repeat
        between, total = (int(steps * rows_per_step) for steps in (config.checkpoint_every, config.env_steps))
        held = 0 if self._checkpoint is None else count_rows(self._checkpoint)
        return max(0, most_rows(config.replay.capacity, between, total) - held)

    def _make_hindsight(self, task: GoalTask | None) -> list[Hindsight]:
        """Return a collector for each environment, or none."""
        replay, learner = self._config.replay, self._config.learner
        if not replay.hindsight or task is None:
            return []

        def draw_goals(count: int) -> ndarray:
            return task.achieved(self.replay.observations(self._rng.integers(len(self.replay), size=count)))

        draw = (draw_goals, replay.hindsight_random) if replay.hindsight_random else ()
        arguments = (task, replay.hindsight, learner.n_step, learner.gamma, self._rng, *draw)
        return [Hindsight(*arguments) for _ in range(self._envs.num_envs)]

    def _restart(self, which: ndarray) -> Float[ndarray, "E O"]:
        """Start new episodes where ``which`` [E] is true; return all observations."""
        seeds = [0] * self._envs.num_envs
        for env in np.flatnonzero(which).tolist():
            seeds[env] = self._curriculum.begin(env, len(self._echoes))
            self._returns[env], self._success[env], self._length[env] = 0.0, False, 0
            tries_again = bool(self._curriculum.retried[env] and not self._curriculum.echoed[env])
            self._exploration.begin_episode(env, self.env_steps, tries_again)
        observation = reset_some(self._envs, which, seeds, self._config.success_overtime)
        for env in np.flatnonzero(which).tolist():
            self._echoes.begin(env, observation[env], bool(self._curriculum.echoed[env]))
        return observation

    def _step(self, observation: Float[ndarray, "E O"]) -> Float[ndarray, "E O"]:
        """Act once in every environment, learning meanwhile; return the next observations."""
        action = self._echoes.act(self._explore(observation), self._success)
        begin_step(self._envs, action)
        self._learn()
        next_observation, reward, terminated, truncated, info = finish_step(self._envs)
        truncated = truncated | self._curriculum.step(self._success, info["env_steps"])
        learnt = learnt_reward(reward, info, self._config.success_bonus)
        for env, n_step in enumerate(self._n_steps):
            step = (observation[env], action[env], float(learnt[env]), next_observation[env])
            self.replay.add(n_step.push(*step, bool(terminated[env]), bool(truncated[env])), env)
        achieved = info.get(ACHIEVED, [None] * len(action))
        for env, hindsight in enumerate(self._hindsight):
            ended = bool(terminated[env]), bool(truncated[env])
            seen = (observation[env], action[env], next_observation[env])
            self.replay.add(hindsight.push(*seen, *ended, achieved[env]))
        self.agent.update_statistics(next_observation)
        self.env_steps += int(info["env_steps"].sum())
        self._returns += reward
        self._length += info["env_steps"]
        if "success" in info:
            self._tells = True  # from now on: some environments tell of it at the end of an episode alone
            self._success |= info["success"].astype(np.bool_)
        done = terminated | truncated
        if not done.any():
            return next_observation
        for env in np.flatnonzero(done).tolist():
            self.episodes += 1
            self.replay.end_episode(env, self._value())
            success = bool(self._success[env]) if self._tells else None
            self._learn_of_end(env, success)
            self._zoo.add_episode(
                float(self._returns[env]), int(self._length[env]), self.seconds, success, self.env_steps
            )
            if self._curriculum.echoed[env]:  # tells nothing of the policy
                self.metrics.gather({"echo_success": float(self._success[env])})
                continue
            figures = {"episode_return": self._returns[env], "episode_length": float(self._length[env])}
            self.metrics.gather(figures | ({"episode_success": float(self._success[env])} if self._tells else {}))
        return self._restart(done)

    def _learn_of_end(self, env: int, success: bool | None) -> None:
        """Tell all that watch training how an environment's episode ended; None where the scene does not tell."""
        echoed = bool(self._curriculum.echoed[env])
        self._echoes.end(env, bool(success))
        self._curriculum.end(env, success)
        self._exploration.end_episode(success, self.env_steps, echoed)
        if not echoed:  # which tells nothing of the policy
            self._monitor.end_episode(self.env_steps, float(self._returns[env]), success)

    def _explore(self, observation: Float[ndarray, "E O"]) -> Float[ndarray, "E A"]:
        """Return random actions in the warm-up, then some around the policy's."""
        if self._acted < self._config.warmup_steps:
            return self._exploration.warm_up()
        return self._exploration.around(self.agent.act(observation), self.env_steps)

    def _learn(self) -> None:
        """Do the updates that the steps so far are worth."""
        config = self._config
        starts = config.warmup_steps if config.learning_starts is None else config.learning_starts
        if self._acted < (max(starts, config.warmup_steps) if config.demonstrations else starts):
            return
        self.demonstrations.clone(self.agent, self.replay, self.metrics.gather)
        if len(self.replay) < config.learner.batch_size:
            return
        self._credit += config.learner.updates_per_step * self._envs.num_envs
        while self._credit >= 1.0:
            self.metrics.gather(self.agent.update(self.replay, self._beta()))
            self._credit -= 1.0

    def _value(self) -> Callable[[ndarray], float] | None:
        """Return what tells the worth of an observation, once the agent has learnt anything."""
        return self.agent.value if self.agent.updates and isinstance(self.agent, ValuingAgent) else None

    def _beta(self) -> float:
        return linear_schedule(self._config.replay.beta, 1.0, self._config.env_steps, self.env_steps)

    def _react(self, progress: Progress) -> None:
        """If nothing has improved for as long as ``learner.reset_after``, start networks and exploration anew.

        The memory stays. Exploration has to return, too: networks that learn from the same memory, and act with as
        little noise, come to rest at the same place.
        """
        patience, stuck = self._config.learner.reset_after, self._monitor.stuck_for(self.env_steps)
        if not patience or stuck < patience or not self.agent.updates:
            return
        progress.say(
            f"{self.env_steps} env steps: nothing has improved for {stuck} of them; "
            "networks and exploration start anew, with the memory so far"
        )
        self.agent.reset()
        self.demonstrations.forget()
        self._credit += self._config.learner.reset_updates
        self._monitor.forgive(self.env_steps)
        self._exploration.begin(self.env_steps)

    def _log(self, updates_per_second: float) -> None:
        if self.agent.updates:
            self.metrics.gather(self.agent.diagnose(self.replay))
        self.metrics.write(
            env_steps=self.env_steps,
            seconds=self.seconds,
            episodes=self.episodes,
            noise=self._exploration.scale(self.env_steps),
            beta=self._beta(),
            priority_spread=self.replay.priority_spread(),
            stuck_for=self._monitor.stuck_for(self.env_steps),
            updates_per_second=updates_per_second,
        )
