"""From a scene's name to the environments that agents act in: observation, action repeat, time limit, processes."""

import dataclasses
import functools
import multiprocessing
import signal
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

import gymnasium
import numpy as np
from gymnasium.vector import AsyncVectorEnv, AutoresetMode
from numpy import ndarray

from nerf_rl.errors import UserError
from nerf_rl.hub.fetch import resolve
from nerf_rl.machine.gl import use_one_software_thread
from nerf_rl.machine.processes import start_method, start_server
from nerf_rl.rl.config import BLIND, NO_CONTROL, RANDOM, PandaReachConfig
from nerf_rl.rl.environments.encoder_match import compare_scenes
from nerf_rl.rl.environments.goals import DESIRED, AchievedGoal, GoalBesideLatent, GoalTask, goal_layout, has_goal
from nerf_rl.rl.environments.observed_columns import ObservedColumns
from nerf_rl.rl.environments.panda_reach import PANDA_REACH, PandaReach
from nerf_rl.rl.environments.scripted import ScriptedActions
from nerf_rl.rl.environments.wrappers import (
    ActionRepeat,
    StateObservation,
    TimeLimit,
    TracedErrors,
    with_flat_observation,
    with_unit_actions,
)
from nerf_rl.scenes.base import GYM, METAWORLD, Scene
from nerf_rl.scenes.make import MJCF_ENDINGS, make_scene, scene_modules


@dataclass(frozen=True)
class EnvSpec:
    """What decides an agent's environment; picklable, so that worker processes can build it."""

    scene: str
    """metaworld/TASK, gym/ID or panda/reach"""
    encoder: str | None
    """path or address of the encoder, or None to observe the true state"""
    action_repeat: int
    """environment steps for which an action is held"""
    episode_steps: int
    """environment steps after which an episode is truncated"""
    panda: PandaReachConfig = field(default_factory=PandaReachConfig)
    """panda/reach only"""
    observe: tuple[str, ...] = ()
    """columns of the true state, or groups of them, that are observed beside latent and proprioception"""
    control: str = NO_CONTROL
    """none, blind or random: eyes that see nothing or that nobody trained, with everything else the same"""


def spec_from_json(content: dict[str, Any]) -> EnvSpec:
    """Return the specification behind ``dataclasses.asdict(spec)``."""
    panda, observe = PandaReachConfig(**content.get("panda", {})), tuple(content.get("observe", ()))
    return EnvSpec(**{**content, "panda": panda, "observe": observe})


def make_env(spec: EnvSpec, encoder: Any = None, device: str = "cpu") -> tuple[gymnasium.Env, Scene | None]:
    """Return an agent's environment in this process, and the MuJoCo scene behind it (None for panda/reach).

    Args:
        spec: what to build.
        encoder: the loaded encoder of ``spec.encoder``, if the caller has it already.
        device: to run the encoder on.

    Raises:
        UserError: no such scene, one without a reward, observations or actions that are no vectors, an episode longer
            than Meta-World allows, an encoder of another scene, no such columns to observe.
    """
    use_one_software_thread()
    scene = None if spec.scene == PANDA_REACH else _make_scene(spec)
    env: gymnasium.Env = PandaReach(spec.panda) if scene is None else with_unit_actions(scene.env)
    env = _with_script(env, scene)
    env = ActionRepeat(TimeLimit(env, spec.episode_steps), spec.action_repeat)
    if scene is None or spec.encoder is None:
        return StateObservation(with_flat_observation(env), np.asarray if scene is None else scene.state), scene
    # these load torch, which a state worker does without
    from nerf_rl.pretrain.model.encoder import Encoder
    from nerf_rl.rl.environments.controls import standardise_by_looking
    from nerf_rl.rl.environments.observation import LatentObservation

    observed = ObservedColumns(scene, spec.observe)

    def beside_latent(observation: Any) -> ndarray:
        return np.concatenate([scene.proprio(observation), scene.motion(observation), observed(observation)])

    eyes = encoder or Encoder.load(spec.encoder)
    compare_scenes(eyes.scene, spec.scene)
    eyes = eyes.untrained() if spec.control == RANDOM else eyes
    env = AchievedGoal(env) if has_goal(env) else env
    latent = LatentObservation(env, eyes, beside_latent, device, spec.control == BLIND)
    if spec.control == RANDOM:
        standardise_by_looking(latent)
    return latent, scene


def make_goal_task(spec: EnvSpec, beside_latent: Sequence[str] = ()) -> GoalTask | None:
    """Return what hindsight needs to know of a task; None for scenes whose goals cannot be exchanged.

    Args:
        spec: of the agent's environment.
        beside_latent: what :func:`check_scene` returns of it.

    Raises:
        UserError: the agent has an encoder and does not observe the goal, which thereby cannot be exchanged.
    """
    env: Any = PandaReach(spec.panda) if spec.scene == PANDA_REACH else _make_scene(spec).env
    if not has_goal(env):
        return None
    layout, shape = goal_layout(env), env.observation_space[DESIRED].shape
    if spec.encoder is None:
        return GoalTask(env.unwrapped, layout, shape)
    first = f"{DESIRED}_0"
    if first not in beside_latent:
        raise UserError(
            "--replay.hindsight exchanges the desired goal, which an agent with an --encoder observes by --observe "
            f'"[{DESIRED}]" alone; give it, or leave out hindsight'
        )
    beside = GoalBesideLatent(beside_latent.index(first) - len(beside_latent), layout.goal)
    return GoalTask(env.unwrapped, beside, shape)


def check_scene(spec: EnvSpec, demonstrations: bool = False) -> tuple[str, ...]:
    """Return the names of what is observed beside a latent.

    Args:
        spec: what is to be built.
        demonstrations: whether a scripted policy is needed.

    Raises:
        UserError: the scene, its episodes or columns of it cannot be had, or it has no such policy.
    """
    env, scene = make_env(dataclasses.replace(spec, encoder=None))
    env.close()
    if demonstrations and (scene is None or scene.scripted_policy() is None):
        raise UserError(
            f"--demonstrations needs a scene with a scripted policy, and {spec.scene} has none; available: "
            f"{METAWORLD}TASK, for example {METAWORLD}drawer-open-v3"
        )
    if scene is None:
        return ()
    return (*scene.proprio_names, *scene.motion_names, *ObservedColumns(scene, spec.observe).names)


def make_vector_env(spec: EnvSpec, count: int, device: str = "cpu") -> AsyncVectorEnv:
    """Return ``count`` environments, each in a process with one thread and its encoder on ``device``.

    They never reset themselves (Gymnasium's ``AutoresetMode.DISABLED``): a step always returns the true observation
    after it, also the last of an episode, and the caller starts episodes with
    :func:`nerf_rl.rl.environments.vector.reset_some`, seed by seed.
    """
    return AsyncVectorEnv(
        [env_maker(spec, device)] * count, context=worker_start_method(spec), autoreset_mode=AutoresetMode.DISABLED
    )


def env_maker(spec: EnvSpec, device: str = "cpu") -> Callable[[], gymnasium.Env]:
    """Return what builds an agent's environment in a process of its own, and can be sent there.

    An encoder of the Hub is fetched here, once for all processes: those need no network, and no settings for it.
    """
    encoder = None if spec.encoder is None else str(resolve(spec.encoder))
    return functools.partial(_make_worker_env, dataclasses.replace(spec, encoder=encoder), device)


def worker_start_method(spec: EnvSpec) -> str:
    """Return how to start the processes of environments, see :func:`nerf_rl.machine.processes.start_method`."""
    return start_method(_worker_modules(spec))


def begin_workers(spec: EnvSpec) -> None:
    """Begin the imports of the processes of environments, which take seconds, beside those of this process."""
    start_server(_worker_modules(spec))


def _worker_modules(spec: EnvSpec) -> list[str]:
    eyes = [] if spec.encoder is None else ["nerf_rl.rl.environments.observation", "nerf_rl.rl.environments.controls"]
    return [__name__, *scene_modules(spec.scene), *eyes]


def _with_script(env: gymnasium.Env, scene: Scene | None) -> gymnasium.Env:
    """Return an environment that knows what its scene's scripted policy would do, if there is one."""
    if scene is None or scene.scripted_policy() is None:
        return env
    return ScriptedActions(env, scene.scripted_policy)


def _make_scene(spec: EnvSpec) -> Scene:
    if spec.scene.endswith(MJCF_ENDINGS):
        raise UserError(
            f"{spec.scene} says nothing of a task: an MJCF file has no reward; register an environment of it with "
            f"Gymnasium, as examples/reach_block.py does, and give {GYM}MODULE:ID as --scene"
        )
    if not spec.scene.startswith((METAWORLD, GYM)):
        available = f"{METAWORLD}TASK, for example {METAWORLD}drawer-open-v3, {GYM}ID, for example {GYM}Reacher-v5"
        raise UserError(f"unknown scene '{spec.scene}'; available: {available}, and {PANDA_REACH}")
    scene = make_scene(spec.scene)
    longest = getattr(scene.env.unwrapped, "max_path_length", None)
    if longest is not None and spec.episode_steps > longest:
        raise UserError(
            f"--episode_steps {spec.episode_steps} is more than the {longest} steps that {spec.scene} allows"
        )
    return scene


def _make_worker_env(spec: EnvSpec, device: str = "cpu") -> gymnasium.Env:
    """Return an agent's environment in a worker process of its own, which leaves Ctrl-C to its parent."""
    if multiprocessing.parent_process() is not None:
        signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is the learner's to handle; it closes the workers
        if spec.encoder is not None:
            import torch

            torch.set_num_threads(1)
        return TracedErrors(make_env(spec, device=device)[0])
    return make_env(spec, device=device)[0]
