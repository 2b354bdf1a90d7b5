"""``nerf-rl train-rl``: from an encoder (or the true state) to a policy."""

import dataclasses
import math
from pathlib import Path
from typing import TYPE_CHECKING, Any

from nerf_rl.errors import UserError
from nerf_rl.files.outputs import check_output, prepare_output, require_outside, require_place, write_provenance
from nerf_rl.hub.address import is_address
from nerf_rl.hub.fetch import lasting
from nerf_rl.loggers import closed_at_end, require_loggers
from nerf_rl.machine.devices import check_device, resolve_device
from nerf_rl.machine.extras import import_extra
from nerf_rl.progress import Progress
from nerf_rl.rl.config import BASELINES, NO_ENCODER, TrainRLConfig
from nerf_rl.rl.environments.encoder_match import check_encoder_scene, warn_of_workers_rendering
from nerf_rl.rl.sweeps.runs import is_training
from nerf_rl.rl.sweeps.sweep import require_one_run, train_seeds
from nerf_rl.rl.sweeps.workers import begin_seeds
from nerf_rl.rl.training.evaluation_results import describe_episodes
from nerf_rl.rl.training.run_files import OnEvaluation, RunRecord

if TYPE_CHECKING:
    import gymnasium

    from nerf_rl.rl.environments.goals import GoalTask
    from nerf_rl.rl.environments.make import EnvSpec


def train_rl(config: TrainRLConfig, on_evaluation: OnEvaluation | None = None) -> dict[str, Any]:
    """Train an agent into the run folder ``config.out``; return its summary.

    With ``config.seeds`` train one for each seed, in run folders inside it; return the summary of all.

    Args:
        config: of the run.
        on_evaluation: called with each evaluation; what it raises ends the training. Not with several seeds.

    Raises:
        UserError: an unknown scene, an encoder that is missing or of another scene, no such columns to observe, an
            existing run, a full disk, an extra that is not installed, a device that is not there.
        FailureError: the run diverged, or some of several seeds failed.
    """
    encoder = None if config.encoder == NO_ENCODER else lasting(config.encoder)
    if encoder is not None:
        check_encoder_scene(encoder, config.scene)
        if not config.resume:
            require_outside(Path(config.out), encoder)
        if is_address(encoder):  # what it stands for may change before the run is resumed
            config = dataclasses.replace(config, encoder=encoder)
    check_device(config.device)
    require_loggers(config.loggers)
    is_baseline = config.algo in BASELINES
    if is_baseline:
        import_extra("stable_baselines3", "sb3", f"--algo {config.algo}")
    from nerf_rl.rl.environments.make import EnvSpec, begin_workers, check_scene, make_goal_task, make_vector_env
    from nerf_rl.rl.environments.vector import close_all

    observe = tuple(config.observe)
    spec = EnvSpec(
        config.scene, encoder, config.action_repeat, config.episode_steps, config.panda, observe, config.control
    )
    if config.seeds:
        begin_seeds(config)
    else:
        begin_workers(spec)
    if not is_baseline:
        from nerf_rl.rl.agents.agent import find_agent

        find_agent(config.algo, cloning=config.demonstrations > 0, valuing=config.learner.uses_returns)
    run = Path(config.out)
    if config.resume and not config.seeds:
        require_one_run(run)
    begun = config.resume and not config.seeds and _can_resume(run, config)
    resuming = begun and not is_baseline  # which begins anew
    beside_latent = check_scene(spec, config.demonstrations > 0)
    if config.replay.hindsight_random and encoder is not None:
        raise UserError(
            f"--replay.hindsight_random {config.replay.hindsight_random} draws goals from what was observed at any "
            "time, and an agent with an --encoder does not observe what it achieved; give 0"
        )
    goal_task = make_goal_task(spec, beside_latent) if config.replay.hindsight else None
    if config.replay.hindsight and goal_task is None:
        raise UserError(f"--replay.hindsight needs a scene with a goal in its observation; {config.scene} has none")
    if config.seeds:
        return train_seeds(train_rl, config)
    check_output(run, config.overwrite, config.resume, resuming, "train-rl")

    envs = make_vector_env(spec, config.envs, str(resolve_device(config.device)))
    try:
        if encoder is not None:
            warn_of_workers_rendering(encoder, envs)
        sizes = (_size(envs.single_observation_space), _size(envs.single_action_space))
        if not is_baseline and not resuming:
            from nerf_rl.rl.experience.replay import require_room

            require_room(require_place(run), *sizes, config.replay.capacity)
        # once its environments stand and its memory has room: what was there before may have taken hours
        prepare_output(run, config.overwrite, config.resume, resuming, "train-rl")
        write_provenance(run, "train-rl", config)
        print(f"train-rl writes to {run}", flush=True)
        record = RunRecord(config, spec, sizes, list(beside_latent if encoder else ()), on_evaluation)
        if is_baseline:
            return _train_baseline(config, spec, envs, record)
        return _train(config, goal_task, envs, record)
    finally:
        close_all(envs)


def _train(config: TrainRLConfig, goal_task: "GoalTask | None", envs: Any, record: RunRecord) -> dict[str, Any]:
    """Alternate training, evaluation and checkpoints; rewrite the policy after each evaluation."""
    from nerf_rl.rl.training.loop import Trainer

    trainer = Trainer(config, envs, Path(config.out), goal_task)
    pauses = (config.evaluation_every, config.checkpoint_every)

    def evaluate(episodes: int) -> None:
        progress.say(describe(trainer.evaluate(episodes), trainer.seconds))
        record.keep(trainer.agent.policy(), config.network, trainer)

    try:
        with (
            closed_at_end(trainer.metrics.loggers),
            Progress(config.env_steps, "env steps", done=trainer.env_steps) as progress,
        ):
            trainer.demonstrate(progress)
            while not trainer.finished:
                before = trainer.env_steps
                trainer.train(progress, min(config.env_steps, *((before // every + 1) * every for every in pauses)))
                if trainer.finished:
                    break
                if trainer.env_steps // config.evaluation_every > before // config.evaluation_every:
                    evaluate(config.evaluation_episodes)
                if trainer.env_steps // config.checkpoint_every > before // config.checkpoint_every:
                    trainer.save()
            if not trainer.is_evaluated(config.final_evaluation_episodes):
                evaluate(config.final_evaluation_episodes)  # also of a run that is to end where it was interrupted
                trainer.save()
            else:  # by its checkpoint it had come to its end; the policy that is there may be a later one's
                record.keep(trainer.agent.policy(), config.network, trainer)
        return record.finish(trainer, trainer.agent.updates, envs.processes, trainer.demonstrations.cost)
    finally:
        trainer.replay.close()


def _train_baseline(config: TrainRLConfig, spec: "EnvSpec", envs: Any, record: RunRecord) -> dict[str, Any]:
    """Let Stable-Baselines3 train; rewrite the policy after each evaluation."""
    from nerf_rl.rl.baselines.models import layered_config
    from nerf_rl.rl.baselines.train import BaselineTrainer

    trainer = BaselineTrainer(config, spec, envs, Path(config.out))

    def after_evaluation(result: dict[str, Any], progress: Progress) -> None:
        progress.say(describe(result, trainer.seconds))
        record.keep(trainer.actor(), layered_config(config), trainer)

    try:
        with closed_at_end(trainer.metrics.loggers):
            trainer.train(after_evaluation)
        return record.finish(trainer, trainer.updates, [*envs.processes, *trainer.processes])
    finally:
        trainer.close()


def describe(result: dict[str, Any], seconds: float) -> str:
    """Return a line on an evaluation."""
    return f"{result['env_steps']} env steps, {seconds:.0f} s: {describe_episodes(result)}"


def _can_resume(run: Path, config: TrainRLConfig) -> bool:
    """Tell whether the folder holds an interrupted run; raise UserError if it has other keys or another encoder."""
    if not is_training(run):
        return False
    from nerf_rl.rl.training.checkpoint import require_begun_so

    require_begun_so(run, config, [run])
    return True


def _size(space: "gymnasium.Space") -> int:
    return math.prod(space.shape or ())
