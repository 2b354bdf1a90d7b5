"""What a dataset is made of: scene, cameras, behaviour, size."""

import dataclasses
from dataclasses import dataclass, field

from nerf_rl.errors import UserError


@dataclass
class CameraConfig:
    """A camera that looks at a point; azimuth and elevation are those of the viewing direction, as in MuJoCo."""

    name: str
    """name in the dataset"""
    lookat: list[float] = field(default_factory=lambda: [0.0, 0.68, 0.12])
    """point on the optical axis, in the world or in the body's frame [m]"""
    distance: float = 0.9
    """from the camera to that point [m]"""
    azimuth: float = 90.0
    """heading of the viewing direction around world z [degrees]"""
    elevation: float = -30.0
    """inclination of the viewing direction, negative looks down [degrees]"""
    fovy: float = 45.0
    """vertical field of view [degrees]"""

    def __post_init__(self) -> None:
        if len(self.lookat) != 3:
            raise UserError(f"camera '{self.name}': lookat needs 3 numbers, got {len(self.lookat)}")
        if self.distance <= 0 or not -90 < self.elevation < 90 or not 0 < self.fovy < 180:
            raise UserError(
                f"camera '{self.name}': distance must be positive, elevation in (-90, 90) and fovy in (0, 180)"
            )


def default_cameras() -> list[CameraConfig]:
    """Return three views of Meta-World's table: from either side and from above."""
    return [
        CameraConfig("left", azimuth=20.0, elevation=-30.0),
        CameraConfig("right", azimuth=160.0, elevation=-30.0),
        CameraConfig("top", azimuth=90.0, elevation=-70.0),
    ]


@dataclass
class RandomCameraConfig:
    """Supervision cameras with a fresh pose in each frame, uniform in ranges [low, high]."""

    count: int = 0
    """how many such cameras each frame has"""
    lookat: list[float] = field(default_factory=lambda: [0.0, 0.68, 0.12])
    """centre of the box that the look-at point is drawn from [m]"""
    lookat_spread: float = 0.05
    """half the edge of that box [m]"""
    distance: list[float] = field(default_factory=lambda: [0.7, 1.1])
    """distance to the look-at point [m]"""
    azimuth: list[float] = field(default_factory=lambda: [10.0, 170.0])
    """heading of the viewing direction [degrees]"""
    elevation: list[float] = field(default_factory=lambda: [-75.0, -15.0])
    """inclination of the viewing direction [degrees]"""
    fovy: float = 45.0
    """vertical field of view [degrees]"""

    def __post_init__(self) -> None:
        if self.count < 0 or len(self.lookat) != 3:
            raise UserError("random cameras need a count of 0 or more and a lookat of 3 numbers")
        for name in ("distance", "azimuth", "elevation"):
            limits = getattr(self, name)
            if len(limits) != 2 or limits[0] > limits[1]:
                raise UserError(f"random cameras: {name} needs [low, high], got {limits}")


@dataclass
class RigConfig:
    """Cameras of a dataset. Encoder cameras feed the encoder; all but test cameras supervise the radiance field."""

    cameras: list[CameraConfig] = field(default_factory=default_cameras)
    """fixed cameras"""
    encoder: list[str] = field(default_factory=list)
    """names of the cameras that the encoder sees (all fixed cameras if empty)"""
    test: list[str] = field(default_factory=list)
    """names of cameras kept out of training"""
    random: RandomCameraConfig = field(default_factory=RandomCameraConfig)
    """further supervision cameras with a fresh pose in each frame"""


@dataclass
class BehaviourConfig:
    """How episodes are acted: each draws one behaviour by weight."""

    random: float = 0.3
    """weight of random actions, each held for a few steps"""
    scripted: float = 0.2
    """weight of the task's scripted policy"""
    noisy: float = 0.5
    """weight of the scripted policy with noise and random detours"""
    noise: float = 0.6
    """standard deviation of the noise on scripted actions (actions are in [-1, 1])"""

    def __post_init__(self) -> None:
        weights = self.weights()
        if min(weights) < 0 or sum(weights) <= 0:
            raise UserError("behaviour weights must not be negative and must not all be zero")

    def weights(self) -> list[float]:
        """Return the weights of random, scripted and noisy episodes."""
        return [self.random, self.scripted, self.noisy]


@dataclass
class ClassConfig:
    """A semantic class by pattern: geoms whose path (body/body/.../geom or mesh name) matches belong to it."""

    name: str
    """class name"""
    pattern: str
    """regular expression, searched in the path"""


@dataclass
class GenDatasetConfig:
    """Keys of ``nerf-rl gen-dataset``."""

    out: str
    """output folder"""
    scene: str = "metaworld/drawer-open-v3"
    """metaworld/TASK, gym/ID or the path of an MJCF file"""
    episodes: int = 200
    """episodes, each with its own reset"""
    frames_per_episode: int = 8
    """frames kept of each episode, at random steps"""
    episode_steps: int = 100
    """environment steps of an episode"""
    size: int = 64
    """image height and width [pixels]"""
    quality: str = "fast"
    """fast: meshes simplified for the image size; full: full meshes, shadows and multisampling"""
    rig: RigConfig = field(default_factory=RigConfig)
    """cameras"""
    behaviour: BehaviourConfig = field(default_factory=BehaviourConfig)
    """how episodes are acted"""
    classes: list[ClassConfig] = field(default_factory=list)
    """semantic classes by pattern, tried in order before the automatic ones"""
    validation_fraction: float = 0.1
    """share of episodes held out for validation"""
    episodes_per_shard: int = 50
    """episodes in a shard file"""
    workers: int = 2
    """render processes"""
    seed: int = 0
    """seed of everything random"""
    resume: bool = False
    """keep the finished shards of an interrupted run with the same configuration"""
    overwrite: bool = False
    """replace an existing dataset"""

    def __post_init__(self) -> None:
        for name in ("episodes", "frames_per_episode", "episode_steps", "episodes_per_shard", "workers"):
            if getattr(self, name) < 1:
                raise UserError(f"--{name} must be at least 1, got {getattr(self, name)}")
        if self.size < 8:
            raise UserError(f"--size must be at least 8, got {self.size}")
        if self.quality not in ("fast", "full"):
            raise UserError(f"unknown quality '{self.quality}'; available: fast, full")
        if self.frames_per_episode > self.episode_steps + 1:
            raise UserError(
                f"--frames_per_episode {self.frames_per_episode} needs at least as many --episode_steps, "
                f"got {self.episode_steps}"
            )
        if not 0 <= self.validation_fraction < 1:
            raise UserError(f"--validation_fraction must be in [0, 1), got {self.validation_fraction}")

    def content(self) -> dict:
        """Return the keys that decide the content of the dataset (not where, how fast or in how many processes)."""
        ignored = ("out", "workers", "resume", "overwrite")
        return {key: value for key, value in dataclasses.asdict(self).items() if key not in ignored}
