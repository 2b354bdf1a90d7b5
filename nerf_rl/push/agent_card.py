"""The card of an agent: what it observes, how often it succeeds, what stands beside that, how to run it."""

import json
import shlex
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from nerf_rl.errors import MissingFileError, UserError
from nerf_rl.files.json_files import read_json
from nerf_rl.hub.fetch import ENCODER_IN_AGENT
from nerf_rl.push.card import (
    NO_SUMMARY,
    UNKNOWN,
    Naming,
    code,
    front_matter,
    installing,
    joined,
    last_sections,
    picture,
    table,
)
from nerf_rl.push.encoder_card import describe_cameras
from nerf_rl.rl.agents.policy_file import POLICY_DESCRIPTION
from nerf_rl.rl.config import BLIND, EYES_OF_CONTROLS, NO_CONTROL, RANDOM
from nerf_rl.rl.training.evaluation_results import HIGH, LOW, SUCCESS, read_evaluations, with_demonstrations
from nerf_rl.scenes.base import GYM

_TAGS = ("reinforcement-learning", "deep-reinforcement-learning")
_UNCONTROLLED = "No control stands beside it, so nothing here tells what the same agent would reach without seeing."
_INSTEAD = {BLIND: "zeros in place of ", RANDOM: "an untrained encoder's latent in place of "}


@dataclass(frozen=True)
class Control:
    """An agent that was trained the same way with worse eyes."""

    kind: str
    """blind or random"""
    last: Mapping[str, Any]
    """its last evaluation"""


def read_control(run: Path, description: Mapping[str, Any]) -> Control:
    """Return a control for an agent.

    Args:
        run: folder of the control's run.
        description: content of the agent's ``policy.json``.

    Raises:
        UserError: it is no finished control of such an agent.
    """
    try:
        policy = read_json(run / POLICY_DESCRIPTION)
        kind, last = policy["env"].get("control", NO_CONTROL), read_evaluations(run)[-1]
        same = _without_eyes(policy) == _without_eyes(description)
    except (OSError, ValueError, LookupError, TypeError, AttributeError) as error:
        remedy = "train one with nerf-rl train-rl --control blind"
        raise MissingFileError("a finished control", run, f"its files do not say so ({error})", remedy) from error
    if kind not in EYES_OF_CONTROLS:
        known = ", ".join(EYES_OF_CONTROLS)
        raise UserError(f"{run} is an agent with --control {kind}; --controls takes one of {known}")
    if not same:
        raise UserError(f"{run} is no control of this agent: its scene, encoder or episodes are others")
    return Control(kind, last)


def _without_eyes(policy: Mapping[str, Any]) -> dict[str, Any]:
    """Return what an agent and its control have in common."""
    env = {name: value for name, value in policy["env"].items() if name not in ("control", "encoder")}
    return {**env, "encoder": policy["encoder_digest"], "network": policy["network"]}


def agent_card(
    naming: Naming,
    description: Mapping[str, Any],
    encoder: Mapping[str, Any] | None,
    summary: Mapping[str, Any],
    evaluations: Sequence[Mapping[str, Any]],
    controls: Sequence[Control],
) -> str:
    """Return the card's text.

    Args:
        naming: of the agent.
        description: content of its ``policy.json``.
        encoder: content of its encoder's ``encoder.json``; None if it observes the true state.
        summary: content of its ``summary.json``, empty if it has none, as while it is trained.
        evaluations: of its run, oldest first.
        controls: to stand beside its success rate.
    """
    env, address = description["env"], shlex.quote(naming.address)
    last = evaluations[-1] if evaluations else {}
    metrics = {"success_rate": last.get(SUCCESS), "mean_return": last.get("mean_return")}
    seen = [] if encoder is None else ["## What it sees", describe_cameras(encoder)]
    return joined(
        [
            front_matter(naming, "reinforcement-learning", _TAGS, metrics, env["scene"]),
            f"# {naming.name}",
            f"An agent for the scene `{env['scene']}`. It observes {_observed(description, encoder)} and gives "
            f"{description['action_size']} numbers in [-1, 1], which are held for {env['action_repeat']} environment "
            f"steps, for at most {env['episode_steps']} of them in an episode.",
            *picture(naming, "Success rate and return over environment steps"),
            *seen,
            "## Figures",
            *_figures(evaluations, env.get("control", NO_CONTROL), controls),
            *([_UNCONTROLLED] if encoder is not None and _is_alone(env, controls) else []),
            "## How to run it",
            *_registering(env["scene"]),
            installing(naming),
            code(
                "sh",
                f"nerf-rl evaluate --run {address} --out runs/evaluation --episodes 50 --video true",
                f"nerf-rl view {address}",
            ),
            "or, in Python,",
            code("python", *_PYTHON.format(address=json.dumps(naming.address, ensure_ascii=False)).splitlines()),
            *last_sections(naming, _made(description, summary), description.get("packages", {})),
        ]
    )


def _registering(scene: str) -> list[str]:
    """Return where the environment comes from, if it is not Gymnasium's own."""
    module = scene.removeprefix(GYM).rpartition(":")[0]
    if not scene.startswith(GYM) or not module:
        return []
    return [f"Its environment is registered by the Python module `{module}`, which has to be where Python finds it."]


def _is_alone(env: Mapping[str, Any], controls: Sequence[Control]) -> bool:
    return not controls and env.get("control", NO_CONTROL) == NO_CONTROL


def _observed(description: Mapping[str, Any], encoder: Mapping[str, Any] | None) -> str:
    if encoder is None:
        return f"the true state ({description['observation_size']} numbers)"
    beside = description["proprio_names"]
    instead = _INSTEAD.get(description["env"].get("control", NO_CONTROL), "")
    others = f" and {', '.join(f'`{name}`' for name in beside)}" if beside else ""
    return (
        f"{instead}the latent of a frozen encoder, which sees {len(encoder['rig']['names'])} cameras and is in the "
        f"folder `{ENCODER_IN_AGENT}`,{others}"
    )


def _figures(evaluations: Sequence[Mapping[str, Any]], control: str, controls: Sequence[Control]) -> list[str]:
    """Return the last evaluation beside those of the controls, and all others."""
    if not evaluations:
        return [NO_SUMMARY]
    own = "this agent" if control == NO_CONTROL else f"this agent, itself a control: {EYES_OF_CONTROLS[control]}"
    rows = [[own, *_row(evaluations[-1])], *([EYES_OF_CONTROLS[c.kind], *_row(c.last)] for c in controls)]
    heads = ["", "environment steps", "episodes", "success rate, 95 % interval", "mean return"]
    told = "the policy acts without noise, on episodes whose seeds training never used, and the interval is Wilson's"
    parts = [f"Evaluations of the run itself: {told}.", table(heads, rows)]
    if len(evaluations) > 1:
        parts += ["While it learnt:", table(heads[1:], (_row(evaluation) for evaluation in evaluations))]
    return parts


def _row(evaluation: Mapping[str, Any]) -> list[str]:
    rate = UNKNOWN
    if SUCCESS in evaluation:
        rate = f"{evaluation[SUCCESS]:.0%} [{evaluation[LOW]:.0%}, {evaluation[HIGH]:.0%}]"
        rate += with_demonstrations(evaluation)
    steps, episodes = f"{evaluation['env_steps']:,}", str(evaluation["episodes"])
    return [steps, episodes, rate, f"{evaluation['mean_return']:.4g}"]


def _made(description: Mapping[str, Any], summary: Mapping[str, Any]) -> list[tuple[str, Any]]:
    return [
        ("environment steps", description["env_steps"]),
        ("training episodes", summary.get("episodes")),
        ("updates", summary.get("updates")),
        ("seconds", summary.get("seconds")),
    ]


_PYTHON = """from nerf_rl.rl.agents.policy import Policy
from nerf_rl.rl.agents.policy_file import find_run
from nerf_rl.rl.environments.make import make_env

policy = Policy.load(find_run({address}))
env, _ = make_env(policy.spec)
observation, _ = env.reset(seed=0)
action = policy.act(observation[None])[0]"""
