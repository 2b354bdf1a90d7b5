"""Camera rigs: the cameras of a dataset with their roles, intrinsics and poses."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from nerf_rl.cameras import intrinsics_from_fovy, look_at
from nerf_rl.datasets.config import RigConfig
from nerf_rl.errors import UnknownNameError, UserError

ROLES = ("encoder", "supervision", "test")


@dataclass(frozen=True)
class Rig:
    """Cameras in the order of the dataset's view axis: the fixed ones, then those with a fresh pose in each frame."""

    names: tuple[str, ...]
    roles: tuple[str, ...]
    """``encoder`` cameras feed the encoder and supervise; ``supervision`` ones supervise; ``test`` ones do neither"""
    intrinsics: Float[ndarray, "V 3 3"]
    _config: RigConfig

    @property
    def moving(self) -> bool:
        """Whether poses differ from frame to frame."""
        return self._config.random.count > 0

    def poses(self, rng: np.random.Generator) -> Float[ndarray, "V 4 4"]:
        """Return ``camera_from_world`` of all cameras in one frame, drawing those that are random."""
        fixed = [look_at(np.array(c.lookat), c.distance, c.azimuth, c.elevation) for c in self._config.cameras]
        ranges = self._config.random
        for _ in range(ranges.count):
            centre = np.array(ranges.lookat) + rng.uniform(-ranges.lookat_spread, ranges.lookat_spread, 3)
            drawn = [rng.uniform(low, high) for low, high in (ranges.distance, ranges.azimuth, ranges.elevation)]
            fixed.append(look_at(centre, *drawn))
        return np.stack(fixed)


def make_rig(config: RigConfig, size: int) -> Rig:
    """Return the rig of a configuration for square images [pixels].

    Raises:
        UserError: a role names an unknown camera, two cameras share a name, or no camera feeds the encoder.
    """
    fixed = [camera.name for camera in config.cameras]
    names = (*fixed, *(f"random_{i}" for i in range(config.random.count)))
    if len(set(names)) < len(names):
        raise UserError(f"camera names must differ: {', '.join(names)}")
    for role in ("encoder", "test"):
        for name in getattr(config, role):
            if name not in fixed:
                raise UnknownNameError(f"{role} camera", name, fixed)
    both = set(config.encoder) & set(config.test)
    if both:
        raise UserError(f"camera '{min(both)}' cannot be an encoder camera and a test camera")
    encoder = config.encoder or [name for name in fixed if name not in config.test]
    if not encoder:
        raise UserError("the rig needs at least one fixed camera for the encoder: rig.cameras is empty or all are test")
    roles = tuple("encoder" if n in encoder else "test" if n in config.test else "supervision" for n in names)
    fovy = [camera.fovy for camera in config.cameras] + [config.random.fovy] * config.random.count
    return Rig(names, roles, np.stack([intrinsics_from_fovy(angle, size, size) for angle in fovy]), config)
