"""What a dataset is made of: scene, cameras, behaviour, size."""

import dataclasses
import re
from dataclasses import dataclass, field
from typing import Annotated

from nerf_rl.arguments.limits import Count, Limits, Processes, Seed, ShareBelowOne, check_values
from nerf_rl.cameras.rig_config import RigConfig
from nerf_rl.errors import UserError
from nerf_rl.machine.backends import check_backend
from nerf_rl.rendering.class_config import ClassConfig, RobotLinks
from nerf_rl.rendering.quality import Quality

MOST_PIXELS, MOST_SHARDS = 4096, 10**6
_HOW_NOT_WHAT = ("out", "workers", "backend", "worker_timeout", "shard", "estimate", "resume", "overwrite")


@dataclass
class BehaviourConfig:
    """How episodes are acted: each draws one behaviour by weight."""

    random: Annotated[float, Limits(least=0, most=10**6)] = 0.3
    """weight of random actions, each held for 3 to longest_hold steps"""
    scripted: Annotated[float, Limits(least=0, most=10**6)] | None = None
    """weight of the task's scripted policy; none: 0.2 if it has one"""
    noisy: Annotated[float, Limits(least=0, most=10**6)] | None = None
    """weight of the scripted policy with noise and random detours; none: 0.5 if the task has one"""
    replay: Annotated[float, Limits(least=0, most=10**6)] = 0.0
    """weight of states stored earlier; with several episodes stored, each episode replays the one of its own number"""
    states: str = ""
    """what to replay: a dataset of the same model, or an .npz file with qpos [T, nq] or [E, T, nq], and perhaps qvel"""
    noise: Annotated[float, Limits(least=0, most=10**6)] = 0.6
    """standard deviation of the noise on scripted actions (actions are in [-1, 1])"""
    longest_hold: Annotated[int, Limits(least=3, most=10**6)] = 14
    """most steps for which an action is held in random episodes; the longer, the more often it leads to the ends of
    where the robot can go, to which an agent that explores comes as well"""
    scattered: Annotated[float, Limits(least=0, most=1)] = 0.0
    """share of episodes in which things begin elsewhere than the reset puts them: joints that the robot does not move
    anywhere in their range, free bodies anywhere in the workspace"""

    def __post_init__(self) -> None:
        check_values(self, "behaviour.")
        if not any(self.weights(scripted=True)):
            raise UserError("behaviour weights must not all be zero")
        if (self.replay > 0) != bool(self.states):
            raise UserError("behaviour.replay is the weight and behaviour.states the source of a replay: give both")

    def weights(self, scripted: bool) -> list[float]:
        """Return the weights of random, scripted, noisy and replayed episodes.

        Args:
            scripted: whether the task has a scripted policy.
        """
        chosen = (self.scripted, self.noisy)
        usual = (0.2, 0.5) if scripted else (0.0, 0.0)
        by_policy = [default if weight is None else weight for weight, default in zip(chosen, usual, strict=True)]
        return [self.random, *by_policy, self.replay]


@dataclass
class GenDatasetConfig:
    """Keys of ``nerf-rl gen-dataset``."""

    out: str
    """output folder"""
    scene: str = "metaworld/drawer-open-v3"
    """metaworld/TASK, gym/ID or the path of an MJCF file (.xml or .mjcf)"""
    episodes: Count = 200
    """episodes, each with its own reset"""
    frames_per_episode: Count = 8
    """frames kept of each episode, at random steps"""
    episode_steps: Annotated[int, Limits(least=1, most=10**6)] = 100
    """environment steps of an episode"""
    size: Annotated[int, Limits(least=8, most=MOST_PIXELS)] = 64
    """image height and width [pixels]"""
    quality: Quality = "fast"
    """fast: meshes simplified for the image size, a colour a pixel; smooth: four, averaged, and no holes in labels and
    depth; full: full meshes, shadows and multisampling"""
    rig: RigConfig = field(default_factory=RigConfig)
    """cameras"""
    behaviour: BehaviourConfig = field(default_factory=BehaviourConfig)
    """how episodes are acted"""
    classes: list[ClassConfig] = field(default_factory=list)
    """semantic classes by pattern, tried in order before the automatic ones"""
    robot_links: RobotLinks = "together"
    """together: a robot is one class beside its gripper; apart: each of its links that moves by a joint of its own is a
    class by its name; apart_if_alone: so it is where nothing moves but robots without a gripper"""
    validation_fraction: ShareBelowOne = 0.1
    """share of episodes held out for validation"""
    episodes_per_shard: Count = 50
    """episodes in a shard file"""
    workers: Processes = 2
    """render processes"""
    backend: str = "local"
    """where they run: local: on this machine; ray: on a Ray cluster (extra 'ray'; RAY_ADDRESS names it)"""
    worker_timeout: Annotated[float, Limits(above=0, most=10**7)] = 120.0
    """a render process that gets no frame done for so long is ended, and its shard rendered anew [s]"""
    shard: str = ""
    """I/N: render only every N-th shard from the I-th on, as one of N jobs; nerf-rl merge puts the parts together"""
    estimate: bool = False
    """tell frames, bytes and minutes, measured on a few frames, and write nothing"""
    seed: Seed = 0
    """seed of everything random"""
    resume: bool = False
    """keep the finished shards of an interrupted run with the same configuration"""
    overwrite: bool = False
    """replace an existing dataset"""

    def __post_init__(self) -> None:
        check_values(self)
        if -(-self.episodes // self.episodes_per_shard) > MOST_SHARDS:
            raise UserError(f"a dataset has at most {MOST_SHARDS} shards; use a larger --episodes_per_shard")
        check_backend(self.backend)
        self.share()
        if self.frames_per_episode > self.episode_steps + 1:
            raise UserError(
                f"--frames_per_episode {self.frames_per_episode} needs at least as many --episode_steps, "
                f"got {self.episode_steps}"
            )

    def content(self) -> dict:
        """Return the keys that decide the content of the dataset (not where, how fast or in how many processes)."""
        return {key: value for key, value in dataclasses.asdict(self).items() if key not in _HOW_NOT_WHAT}

    def share(self) -> tuple[int, int]:
        """Return I and N of ``shard``, 1 and 1 without."""
        found = re.fullmatch(r"(\d+)/(\d+)", self.shard or "1/1")
        if found is None or not 1 <= int(found[1]) <= int(found[2]):
            raise UserError(f"--shard must be I/N with I from 1 to N, such as 2/8, got '{self.shard}'")
        return int(found[1]), int(found[2])
