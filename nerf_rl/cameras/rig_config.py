"""Which cameras a dataset has: single ones, rings, domes and random ones.

What is left out is fitted to the scene: an empty ``lookat`` is the middle of the workspace, or the origin of the body
that a camera belongs to; a distance of 0 is the one from which the workspace fills the image. Where a robot can travel,
the workspace goes with it, and so do cameras that look at its middle, unless ``rig.follow`` says otherwise.
"""

from dataclasses import dataclass, field
from typing import Any, Literal

from nerf_rl.arguments.limits import check_values
from nerf_rl.errors import UserError

MOST_CAMERAS = 256
AUTO, NOTHING = "auto", "none"
"""what cameras follow: the root of a robot that can travel; nothing"""
ROBOT = "robot"
"""what azimuths may be measured from"""
_LARGEST = 1e6


@dataclass
class CameraConfig:
    """A camera that looks at a point, or one that the model has."""

    name: str
    """name in the dataset"""
    camera: str = ""
    """name of a camera of the model; its pose and field of view are taken, and nothing below is"""
    body: str = ""
    """body that the camera is fixed to, such as the wrist; lookat, position and angles are in the body's frame"""
    follow: str = ""
    """body that the camera follows without turning, along rig.follow_axes; lookat and position are relative to where
    the body is (its height, where that is not followed, to the one that it has at first)"""
    lookat: list[float] = field(default_factory=list)
    """point on the optical axis [m]; empty: the middle of the workspace, or the body's origin"""
    position: list[float] = field(default_factory=list)
    """where the camera is [m], in place of distance, azimuth and elevation"""
    distance: float = 0.0
    """from the camera to the point it looks at [m]; 0: so that the workspace fills the image"""
    azimuth: float = 90.0
    """heading of the viewing direction around world z, as in MuJoCo [degrees]"""
    elevation: float = -30.0
    """inclination of the viewing direction, negative looks down [degrees]"""
    fovy: float = 45.0
    """vertical field of view [degrees]"""

    def __post_init__(self) -> None:
        if not self.name:
            raise UserError("a camera of rig.cameras has an empty name; give it one")
        label = f"camera '{self.name}'"
        _check_point(label, "lookat", self.lookat)
        _check_point(label, "position", self.position)
        _check_view(label, self.distance, self.fovy, self.elevation)
        _check_sizes(label, self.azimuth)
        if sum(bool(kind) for kind in (self.camera, self.body, self.follow)) > 1:
            raise UserError(f"{label} can have one of camera, body and follow")
        if self.body and not self.position and self.distance == 0:
            raise UserError(f"{label} is fixed to body '{self.body}' and needs a position or a distance")


@dataclass
class RingConfig:
    """Cameras at one height around a point, evenly spread; named after the ring: ring_0, ring_1, ..."""

    name: str = "ring"
    """name of the ring; a role given to it is given to all of its cameras"""
    count: int = 3
    """how many cameras"""
    azimuth: float = 90.0
    """heading of the first camera's viewing direction [degrees]"""
    span: float = 360.0
    """angle over which they are spread; below 360 the last camera is at its end [degrees]"""
    elevation: float = -30.0
    """inclination of the viewing directions [degrees]"""
    follow: str = ""
    """body that the ring follows without turning"""
    lookat: list[float] = field(default_factory=list)
    """point that all look at [m]; empty: the middle of the workspace, or the body's origin"""
    distance: float = 0.0
    """from that point [m]; 0: so that the workspace fills the image"""
    fovy: float = 45.0
    """vertical field of view [degrees]"""

    def __post_init__(self) -> None:
        label = f"ring '{self.name}'"
        _check_name(label, self.name)
        _check_point(label, "lookat", self.lookat)
        _check_view(label, self.distance, self.fovy, self.elevation)
        _check_sizes(label, self.azimuth)
        _check_count(label, self.count)
        if self.count < 1 or not 0 < self.span <= 360:
            raise UserError(f"{label} needs a count of 1 or more and a span in (0, 360]")

    def cameras(self) -> list[CameraConfig]:
        """Return the ring's cameras."""
        gaps = self.count if self.span == 360 else max(1, self.count - 1)
        shared = {key: getattr(self, key) for key in ("follow", "lookat", "distance", "elevation", "fovy")}
        return [
            CameraConfig(f"{self.name}_{i}", azimuth=self.azimuth + self.span * i / gaps, **shared)
            for i in range(self.count)
        ]


@dataclass
class DomeConfig:
    """Cameras spread evenly over a part of the sphere around a point; named after the dome: dome_0, dome_1, ..."""

    name: str = "dome"
    """name of the dome; a role given to it is given to all of its cameras"""
    count: int = 12
    """how many cameras"""
    elevation: list[float] = field(default_factory=lambda: [-80.0, -10.0])
    """lowest and highest inclination of the viewing directions [degrees]"""
    follow: str = ""
    """body that the dome follows without turning"""
    lookat: list[float] = field(default_factory=list)
    """point that all look at [m]; empty: the middle of the workspace, or the body's origin"""
    distance: float = 0.0
    """from that point [m]; 0: so that the workspace fills the image"""
    fovy: float = 45.0
    """vertical field of view [degrees]"""

    def __post_init__(self) -> None:
        label = f"dome '{self.name}'"
        _check_name(label, self.name)
        _check_point(label, "lookat", self.lookat)
        _check_range(label, "elevation", self.elevation)
        for elevation in self.elevation:
            _check_view(label, self.distance, self.fovy, elevation)
        _check_count(label, self.count)
        if self.count < 1:
            raise UserError(f"{label} needs a count of 1 or more")

    def cameras(self) -> list[CameraConfig]:
        """Return the dome's cameras, on a Fibonacci lattice (Swinbank and Purser 2006): equal areas, golden turns."""
        import numpy as np

        low, high = np.sin(np.deg2rad(self.elevation))
        heights = low + (high - low) * (np.arange(self.count) + 0.5) / self.count
        golden = 180.0 * (3.0 - np.sqrt(5.0))
        shared = {key: getattr(self, key) for key in ("follow", "lookat", "distance", "fovy")}
        return [
            CameraConfig(
                f"{self.name}_{i}",
                azimuth=float(golden * i % 360.0),
                elevation=float(np.rad2deg(np.arcsin(height))),
                **shared,
            )
            for i, height in enumerate(heights)
        ]


@dataclass
class RandomCameraConfig:
    """Supervision cameras with a fresh pose in each frame, uniform in ranges [low, high]."""

    count: int = 0
    """how many such cameras each frame has"""
    follow: str = ""
    """body that they follow without turning"""
    lookat: list[float] = field(default_factory=list)
    """centre of the box that the look-at point is drawn from [m]; empty: that of the workspace, or the body's origin"""
    lookat_spread: float | None = None
    """half the edge of that box [m]; none: a seventh of the workspace's radius"""
    distance: list[float] = field(default_factory=list)
    """distance to the look-at point [m]; empty: 0.8 to 1.2 times that from which the workspace fills the image"""
    azimuth: list[float] = field(default_factory=lambda: [10.0, 170.0])
    """heading of the viewing direction [degrees]"""
    elevation: list[float] = field(default_factory=lambda: [-75.0, -15.0])
    """inclination of the viewing direction [degrees]"""
    fovy: float = 45.0
    """vertical field of view [degrees]"""

    def __post_init__(self) -> None:
        label = "random cameras"
        if self.count < 0:
            raise UserError(f"{label} need a count of 0 or more, got {self.count}")
        _check_count(label, self.count)
        _check_sizes(label, self.lookat_spread)
        _check_point(label, "lookat", self.lookat)
        for name in ("azimuth", "elevation", *(["distance"] if self.distance else [])):
            _check_range(label, name, getattr(self, name))
        for elevation in self.elevation:
            _check_view(label, min(self.distance, default=0.0), self.fovy, elevation)
        if self.lookat_spread is not None and self.lookat_spread < 0:
            raise UserError(f"{label}: lookat_spread must be 0 or more, got {self.lookat_spread}")
        if self.distance and min(self.distance) <= 0:
            raise UserError(f"{label}: distance must be positive, got {self.distance}")


@dataclass
class RigConfig:
    """Cameras of a dataset. Encoder cameras feed the encoder; all but test cameras supervise the radiance field."""

    cameras: list[CameraConfig] = field(default_factory=list)
    """single cameras; those that suit the scene if there are neither these nor rings nor domes"""
    rings: list[RingConfig] = field(default_factory=list)
    """cameras in circles"""
    domes: list[DomeConfig] = field(default_factory=list)
    """cameras over a part of a sphere"""
    encoder: list[str] = field(default_factory=list)
    """names of the cameras, rings or domes that the encoder sees (if empty: all but test cameras and random ones)"""
    test: list[str] = field(default_factory=list)
    """names of cameras, rings or domes kept out of training"""
    random: RandomCameraConfig = field(default_factory=RandomCameraConfig)
    """further supervision cameras with a fresh pose in each frame"""
    follow: str = AUTO
    """body that cameras without a place of their own follow without turning: auto (the root of a robot that can travel,
    else nothing), none, or the name of a body"""
    azimuths: Literal["world", "robot"] = "world"
    """what the azimuths of cameras that look at the middle of the workspace are measured from: world (its x axis), or
    robot: 90 looks an arm that stands beside its workspace in the face; where none does, as world"""
    follow_axes: Literal["xy", "xyz"] = "xy"
    """along which axes cameras follow a body: xy (horizontally) or xyz"""

    def __post_init__(self) -> None:
        check_values(self, "rig.")
        if not self.follow:
            raise UserError(f"rig.follow must be {AUTO}, {NOTHING} or the name of a body")


def _check_point(label: str, name: str, point: list[float]) -> None:
    _check_sizes(label, *point)
    if point and len(point) != 3:
        raise UserError(f"{label}: {name} needs 3 numbers, got {len(point)}")


def _check_count(label: str, count: int) -> None:
    if count > MOST_CAMERAS:
        raise UserError(f"{label}: a dataset has at most {MOST_CAMERAS} cameras, got a count of {count}")


def _check_name(label: str, name: str) -> None:
    if not name:
        raise UserError(f"{label} needs a name")


def _check_sizes(label: str, *numbers: float | None) -> None:
    """Raise UserError if a number [m] or [degrees] is not finite, or larger than any that has a meaning."""
    for number in numbers:
        if number is not None and not abs(number) <= _LARGEST:
            raise UserError(f"{label}: numbers must be from {-_LARGEST} to {_LARGEST}, got {number}")


def _check_range(label: str, name: str, limits: list[Any]) -> None:
    _check_sizes(label, *limits)
    if len(limits) != 2 or limits[0] > limits[1]:
        raise UserError(f"{label}: {name} needs [low, high], got {limits}")


def _check_view(label: str, distance: float, fovy: float, elevation: float) -> None:
    _check_sizes(label, distance)
    if distance < 0 or not -90 < elevation < 90 or not 0 < fovy < 180:
        raise UserError(f"{label}: distance must not be negative, elevation in (-90, 90) and fovy in (0, 180)")
