"""Camera rigs: the cameras of a dataset with their roles, intrinsics and poses."""

from dataclasses import dataclass

import mujoco
import numpy as np
from jaxtyping import Float
from numpy import ndarray

from nerf_rl.cameras.geometry import camera_position, intrinsics_from_fovy, look_at
from nerf_rl.cameras.rig_config import (
    MOST_CAMERAS,
    ROBOT,
    CameraConfig,
    DomeConfig,
    RandomCameraConfig,
    RigConfig,
    RingConfig,
)
from nerf_rl.cameras.tracking_frame import TrackingFrame
from nerf_rl.errors import UnknownNameError, UserError
from nerf_rl.rendering.camera_mounts import Mount, Pose, mount
from nerf_rl.rendering.following import Followers, Following
from nerf_rl.scenes.base import Scene
from nerf_rl.scenes.workspace import Workspace

_SPREAD = 1 / 7  # of random look-at points, in radii of the workspace
_NEAREST = 0.05  # to what a camera shows, at most so near [m]
_DISTANCES = (0.8, 1.2)  # of random cameras, in fitted distances


@dataclass(frozen=True)
class Rig:
    """Cameras in the order of the dataset's view axis: the configured ones, then those that are random."""

    names: tuple[str, ...]
    roles: tuple[str, ...]
    """``encoder`` cameras feed the encoder and supervise; ``supervision`` ones supervise; ``test`` ones do neither"""
    intrinsics: Float[ndarray, "V 3 3"]
    moving: bool
    """whether poses differ from frame to frame"""
    _poses: tuple[Pose, ...]
    _bodies: tuple[int, ...]
    _workspace: Workspace
    _random: "_RandomCameras"
    _following: Following | None

    def poses(self, data: mujoco.MjData, rng: np.random.Generator) -> Float[ndarray, "V 4 4"]:
        """Return ``camera_from_world`` of all cameras in a state, drawing those that are random.

        Args:
            data: the state, with positions propagated.
            rng: for the random cameras; untouched if there are none.
        """
        return np.stack([*(place(data) for place in self._poses), *self._random.poses(data, rng)])

    @property
    def tracking_frame(self) -> TrackingFrame | None:
        """In which all cameras of the encoder stand still, because they follow one body; else None."""
        return None if self._following is None else self._following.frame

    def origin(self, data: mujoco.MjData) -> Float[ndarray, "3"]:
        """Return where the tracking frame's origin is in a state with propagated positions [m]; 0 without one."""
        return np.zeros(3) if self._following is None else self._following.origin(data)

    def pixels_per_metre(self, data: mujoco.MjData) -> float:
        """Return how many pixels a metre takes in an image where a camera is nearest to what it is there to show.

        For a camera on a body that is the body, for all others the middle of the workspace.
        """
        positions = camera_position(np.stack([place(data) for place in self._poses]))
        targets = np.stack([self._workspace.centre if body < 0 else data.xpos[body] for body in self._bodies])
        distance = np.linalg.norm(positions - targets, axis=1)
        distance = np.concatenate([distance, np.full(self._random.count, self._random.nearest)])
        return float((self.intrinsics[:, 0, 0] / np.maximum(distance, _NEAREST)).max())


def make_rig(config: RigConfig, size: int, scene: Scene) -> Rig:
    """Return the rig of a configuration for square images [pixels].

    Args:
        config: the cameras.
        size: image height and width [pixels].
        scene: what they look at.

    Raises:
        UserError: a camera, body or role name that is unknown, two cameras of one name, or no camera for the encoder.
    """
    groups = {camera.name: [camera] for camera in config.cameras}
    if len(groups) < len(config.cameras):
        raise UserError(f"camera names must differ: {', '.join(camera.name for camera in config.cameras)}")
    several: list[RingConfig | DomeConfig] = [*config.rings, *config.domes]
    for group in several:
        if group.name in groups:
            raise UserError(f"two cameras, rings or domes are named '{group.name}'")
        groups[group.name] = group.cameras()
    turn = scene.workspace().turn if config.azimuths == ROBOT or not groups else 0.0
    if not groups:
        groups = {camera.name: [camera] for camera in scene.default_cameras()}
    cameras = [camera for group in groups.values() for camera in group]
    names = [camera.name for camera in cameras]
    names += [f"random_{i}" for i in range(config.random.count)]
    if len(names) > MOST_CAMERAS:
        raise UserError(f"a dataset has at most {MOST_CAMERAS} cameras, these are {len(names)}")
    if len(set(names)) < len(names):
        raise UserError(f"camera names must differ: {', '.join(names)}")

    model, workspace = scene.model, scene.workspace()
    followers = Followers(config, model, workspace, scene.render_data())
    mounted = [mount(camera, model, workspace, followers, turn) for camera in cameras]
    random = _RandomCameras(config.random, workspace, followers, turn)
    roles = _roles(config, groups, names)
    encoder = [camera for camera, role in zip(mounted, roles, strict=False) if role == "encoder"]  # none is random
    fovy = [camera.fovy for camera in mounted] + [config.random.fovy] * config.random.count
    return Rig(
        names=tuple(names),
        roles=roles,
        intrinsics=np.stack([intrinsics_from_fovy(angle, size, size) for angle in fovy]),
        moving=any(camera.moves for camera in mounted) or config.random.count > 0,
        _poses=tuple(camera.pose for camera in mounted),
        _bodies=tuple(camera.body for camera in mounted),
        _workspace=workspace,
        _random=random,
        _following=_followed_by_all(encoder),
    )


def _followed_by_all(mounted: list[Mount]) -> Following | None:
    """Return what all of these cameras follow, or None if they do not all follow the same body."""
    frames = {camera.following and camera.following.frame for camera in mounted}
    return mounted[0].following if len(frames) == 1 else None


def _roles(config: RigConfig, groups: dict[str, list[CameraConfig]], names: list[str]) -> tuple[str, ...]:
    """Return the role of each camera; the last ones in ``names``, which no group holds, are the random ones."""
    single = {camera.name: [camera] for group in groups.values() for camera in group}
    known = {**single, **groups}

    def named(role: str) -> list[str]:
        wanted = getattr(config, role)
        for name in wanted:
            if name not in known:
                raise UnknownNameError(f"{role} camera", name, known)
        return [camera.name for name in wanted for camera in known[name]]

    encoder, test = named("encoder"), named("test")
    both = set(encoder) & set(test)
    if both:
        raise UserError(f"camera '{min(both)}' cannot be an encoder camera and a test camera")
    encoder = encoder or [name for name in single if name not in test]
    if not encoder:
        raise UserError("the rig needs a camera for the encoder that is neither random nor a test camera")
    return tuple("encoder" if n in encoder else "test" if n in test else "supervision" for n in names)


class _RandomCameras:
    """Cameras with a fresh pose in each frame."""

    def __init__(self, config: RandomCameraConfig, workspace: Workspace, followers: Followers, turn: float):
        self.count = config.count
        self._following = followers.of(config.follow, "random cameras") if config.follow else None
        if not (config.follow or config.lookat):
            self._following = followers.usual
        lookat = np.array(config.lookat or np.zeros(3), np.float64)
        if config.follow and self._following is not None:
            lookat = self._following.point(lookat)
        elif not config.lookat:
            lookat = workspace.centre if self._following is None else self._following.centre
        self._centre = lookat
        self._spread = workspace.radius * _SPREAD if config.lookat_spread is None else config.lookat_spread
        fitted = workspace.distance(config.fovy)
        distance = config.distance or [share * fitted for share in _DISTANCES]
        azimuth = config.azimuth if config.follow or config.lookat else [turn + limit for limit in config.azimuth]
        self._ranges = (distance, azimuth, config.elevation)
        self.nearest = distance[0]

    def poses(self, data: mujoco.MjData, rng: np.random.Generator) -> list[Float[ndarray, "4 4"]]:
        offset = np.zeros(3) if self._following is None else self._following.origin(data)
        drawn = []
        for _ in range(self.count):
            centre = self._centre + rng.uniform(-self._spread, self._spread, 3)
            view = [rng.uniform(low, high) for low, high in self._ranges]
            drawn.append(look_at(centre + offset, *view))
        return drawn
