"""``nerf-rl evaluate``: success rate of a trained policy, with video."""

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from nerf_rl.files.json_files import write_json
from nerf_rl.files.outputs import SUMMARY, check_output, prepare_output, require_outside, write_provenance
from nerf_rl.machine.devices import check_device, resolve_device
from nerf_rl.rl.agents.policy_file import check_policy, find_run
from nerf_rl.rl.environments.encoder_match import warn_of_workers_rendering
from nerf_rl.rl.evaluate_config import EvaluateConfig
from nerf_rl.rl.training.evaluation_results import DEMONSTRATIONS, describe_episodes

if TYPE_CHECKING:
    from nerf_rl.rl.agents.policy import Policy

VIDEO = "episodes.mp4"
_HOLD_FRAMES = 8  # for which the last frame of an episode stays


def evaluate(config: EvaluateConfig) -> dict[str, Any]:
    """Evaluate the policy of ``config.run`` into ``config.out``; return the summary.

    Episodes end where those of the training's own evaluations did: at the first success, or after it.

    Raises:
        UserError: no policy there, not its encoder, an environment that has changed since, no such device, an existing
            output folder.
        FailureError: its actions or its returns are no numbers.
    """
    run, out = find_run(config.run), Path(config.out)
    description = check_policy(run, config.encoder)
    check_device(config.device)
    require_outside(out, run, *filter(None, [config.encoder]))
    check_output(out, config.overwrite)

    from nerf_rl.rl.environments.make import begin_workers, make_vector_env, spec_from_json
    from nerf_rl.rl.environments.vector import close_all

    begin_workers(spec_from_json(description["env"]))
    from nerf_rl.rl.agents.policy import Policy
    from nerf_rl.rl.training.episodes import evaluation_seeds, run_episodes

    device = resolve_device(config.device)
    policy = Policy.load(run, config.encoder, device)
    prepare_output(out, config.overwrite)
    write_provenance(out, "evaluate", config)
    print(f"evaluate writes to {out}", flush=True)
    seeds = evaluation_seeds(config.seed, max(config.episodes, config.video_episodes))
    envs = make_vector_env(policy.spec, min(config.envs, config.episodes), str(device))
    try:
        policy.require_spaces(envs.single_observation_space, envs.single_action_space)
        if policy.spec.encoder is not None:
            warn_of_workers_rendering(policy.spec.encoder, envs)
        found = run_episodes(envs, policy.act, seeds[: config.episodes], policy.to_end)
    finally:
        close_all(envs)
    found.require_numbers(policy.env_steps)
    summary = found.summary() | {"env_steps": policy.env_steps}
    if policy.demonstrations:
        summary[DEMONSTRATIONS] = policy.demonstrations
    if config.video:
        _write_video(out / VIDEO, config, run, policy, seeds[: config.video_episodes], str(device))
        summary["video"] = VIDEO
    write_json(out / SUMMARY, summary)
    print(describe_episodes(summary))
    return summary


def _write_video(
    path: Path, config: EvaluateConfig, run: Path, policy: "Policy", seeds: list[int], device: str
) -> None:
    from nerf_rl.pictures.video import write_mp4
    from nerf_rl.rl.rollout import film, rollout

    clips = [film(rollout(run, seed, "", config.video_size, policy, device)) for seed in seeds]
    held = [np.concatenate([clip, np.repeat(clip[-1:], _HOLD_FRAMES, axis=0)]) for clip in clips]
    write_mp4(path, np.concatenate(held), frames_per_second=20.0)
