"""The cameras that an encoder sees."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float, Float32
from numpy import ndarray

from nerf_rl.cameras.geometry import projection_matrix
from nerf_rl.cameras.tracking_frame import TrackingFrame
from nerf_rl.datasets.storage.reader import MultiViewDataset
from nerf_rl.errors import RigMismatchError, UserError

_FRAMES_AT_ONCE = 4096  # whose poses are read


@dataclass(frozen=True)
class EncoderRig:
    """Cameras with their resolution, which stand still in the world or all follow one body without turning."""

    names: tuple[str, ...]
    intrinsics: Float[ndarray, "V 3 3"]
    """K [pixels]"""
    camera_from_world: Float[ndarray, "V 4 4"]
    """poses, in the tracking frame if the cameras follow a body; there the radiance field lives as well"""
    height: int
    """of an image [pixels]"""
    width: int
    """of an image [pixels]"""
    tracking_frame: TrackingFrame | None = None
    """which goes with the body that the cameras follow; None if they stand still in the world"""

    @property
    def projections(self) -> Float32[ndarray, "V 3 4"]:
        """P = K [R | t] of each camera."""
        return projection_matrix(self.intrinsics, self.camera_from_world).astype(np.float32)

    def require_same(self, other: "EncoderRig") -> None:
        """Raise RigMismatchError, naming the first difference, unless the cameras are the same."""
        for what in ("names", "height", "width"):
            mine, theirs = getattr(self, what), getattr(other, what)
            if mine != theirs:
                raise RigMismatchError(f"{what} {mine} there, {theirs} here")
        if self.tracking_frame != other.tracking_frame:
            raise RigMismatchError(
                f"cameras {_follow(self.tracking_frame)} there, {_follow(other.tracking_frame)} here"
            )
        for i, name in enumerate(self.names):
            for what in ("intrinsics", "camera_from_world"):
                if not np.allclose(getattr(self, what)[i], getattr(other, what)[i], atol=1e-6):
                    raise RigMismatchError(f"camera '{name}' has another {what}")

    def to_json(self) -> dict[str, Any]:
        """Return what :meth:`from_json` reads."""
        return {
            "names": list(self.names),
            "intrinsics": self.intrinsics.tolist(),
            "camera_from_world": self.camera_from_world.tolist(),
            "height": self.height,
            "width": self.width,
            **({} if self.tracking_frame is None else {"tracking_frame": self.tracking_frame.to_json()}),
        }

    @classmethod
    def from_json(cls, content: dict[str, Any]) -> "EncoderRig":
        """Return the rig that ``encoder.json`` describes."""
        intrinsics, poses = np.array(content["intrinsics"]), np.array(content["camera_from_world"])
        frame = TrackingFrame.from_json(content.get("tracking_frame"))
        return cls(tuple(content["names"]), intrinsics, poses, content["height"], content["width"], frame)

    @classmethod
    def of_dataset(cls, dataset: MultiViewDataset) -> "EncoderRig":
        """Return the encoder's cameras in a dataset.

        Raises:
            UserError: they move otherwise than all with one body.
        """
        views = dataset.views("encoder")
        intrinsics, first = dataset.tracked_cameras([0])
        for begin in range(0, len(dataset), _FRAMES_AT_ONCE):  # all of them: what moves may come back
            frames = np.arange(begin, min(begin + _FRAMES_AT_ONCE, len(dataset)))
            if not np.allclose(dataset.tracked_cameras(frames)[1][:, views], first[:, views]):
                raise UserError(
                    f"{dataset.folder}: the encoder's cameras move, but an encoder needs fixed ones, or ones that all "
                    "follow the same body without turning"
                )
        names = tuple(dataset.camera_names[view] for view in views)
        size = dataset.manifest["height"], dataset.manifest["width"]
        return cls(names, intrinsics[views], first[0, views], *size, dataset.tracking_frame)


def _follow(frame: TrackingFrame | None) -> str:
    return "stand still" if frame is None else f"follow {frame.body} along {frame.axes}"
