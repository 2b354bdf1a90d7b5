"""``nerf-rl train-rl``: from an encoder (or the true state) to a policy."""

from pathlib import Path
from typing import TYPE_CHECKING, Any

from nerf_rl.progress import Progress
from nerf_rl.rl.artefact import check_encoder_scene, encoder_digest
from nerf_rl.rl.config import NO_ENCODER, TrainRLConfig
from nerf_rl.runs import SUMMARY, peak_rss_mb, prepare_output, require_same_keys, write_json, write_provenance

if TYPE_CHECKING:
    from nerf_rl.rl.envs import EnvSpec
    from nerf_rl.rl.trainer import Trainer

CURVE = "learning_curve.png"


def train_rl(config: TrainRLConfig) -> dict[str, Any]:
    """Train an agent into the run folder ``config.out``; return its summary.

    Raises:
        UserError: an unknown scene, an encoder that is missing or of another scene, an existing run, a full disk.
    """
    encoder = None if config.encoder == NO_ENCODER else str(Path(config.encoder).resolve())
    if encoder is not None:
        check_encoder_scene(encoder, config.scene)
    run = Path(config.out)
    resuming = config.resume and _can_resume(run, config)

    from nerf_rl.rl.envs import EnvSpec, check_scene, make_vector_env

    spec = EnvSpec(config.scene, encoder, config.action_repeat, config.episode_steps)
    proprio_names = check_scene(spec)
    prepare_output(run, config.overwrite, config.resume, resuming, "train-rl")
    write_provenance(run, "train-rl", config)
    print(f"train-rl writes to {run}", flush=True)

    from nerf_rl.rl.trainer import Trainer

    envs = make_vector_env(spec, config.envs)
    try:
        trainer = Trainer(config, envs, run)
        try:
            return _train(config, trainer, spec, list(proprio_names if encoder else ()), envs.processes)
        finally:
            trainer.replay.close()
    finally:
        envs.close(terminate=True)


def _train(
    config: TrainRLConfig, trainer: "Trainer", spec: "EnvSpec", proprio_names: list[str], workers: list[Any]
) -> dict[str, Any]:
    """Alternate training, evaluation and checkpoints; rewrite the policy after each evaluation."""
    from torch import nn

    from nerf_rl.rl.policy import Policy
    from nerf_rl.rl.records import draw_learning_curve

    run = Path(config.out)
    digest = encoder_digest(spec.encoder) if spec.encoder else None
    pauses = (config.evaluation_every, config.checkpoint_every)
    with Progress(config.env_steps, "env steps", done=trainer.env_steps) as progress:
        while trainer.env_steps < config.env_steps:
            before = trainer.env_steps
            trainer.train(progress, min(config.env_steps, *((before // every + 1) * every for every in pauses)))
            last = trainer.env_steps >= config.env_steps
            if last or trainer.env_steps // config.evaluation_every > before // config.evaluation_every:
                result = trainer.evaluate(config.final_evaluation_episodes if last else config.evaluation_episodes)
                progress.say(describe(result, trainer.seconds))
                sizes = (trainer.observation_size, trainer.action_size)
                actor = nn.Sequential(trainer.agent.norm, trainer.agent.actor)
                Policy(actor, spec, config.network, *sizes, proprio_names, digest, trainer.env_steps).save(run)
                draw_learning_curve(run / CURVE, trainer.evaluations, config.scene)
            if last or trainer.env_steps // config.checkpoint_every > before // config.checkpoint_every:
                trainer.save()
    summary = summarise(trainer, workers)
    write_json(run / SUMMARY, summary)  # last, so that a run with a summary is finished
    return summary


def summarise(trainer: "Trainer", workers: list[Any]) -> dict[str, Any]:
    """Return the content of ``summary.json``; memory is the peak of the learner plus those of its workers."""
    return {
        "env_steps": trainer.env_steps,
        "episodes": trainer.episodes,
        "updates": trainer.agent.updates,
        "seconds": round(trainer.seconds, 1),
        "peak_rss_mb": round(peak_rss_mb() + sum(_peak_rss_mb(worker.pid) for worker in workers), 1),
        "evaluations": trainer.evaluations,
    }


def describe(result: dict[str, Any], seconds: float) -> str:
    """Return a line on an evaluation."""
    return (
        f"{result['env_steps']} env steps, {seconds:.0f} s: success {result['success_rate']:.0%} "
        f"[{result['ci_low']:.0%}, {result['ci_high']:.0%}] of {result['episodes']} episodes, "
        f"return {result['mean_return']:.0f}"
    )


def _can_resume(run: Path, config: TrainRLConfig) -> bool:
    """Tell whether the folder holds an interrupted run; raise UserError if it is one with other keys."""
    if not (run / "config.yaml").is_file():
        return False
    require_same_keys(run, config.content())
    return True


def _peak_rss_mb(pid: int) -> float:
    """Return the peak resident memory of another process [MB]; 0 where Linux's /proc does not tell."""
    try:
        status = Path(f"/proc/{pid}/status").read_text()
    except OSError:
        return 0.0
    return next((int(line.split()[1]) / 1024 for line in status.splitlines() if line.startswith("VmHWM")), 0.0)
