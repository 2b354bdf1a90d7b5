"""A frame of reference that travels with a body: where cameras that follow the body, and what they see, stand still.

Its axes are the world's, since cameras that follow do not turn. Its origin is where the body is, along the axes that
are followed, and that of the world along the others: with ``xy`` the floor stays at height 0 while a robot walks. A
radiance field lives in a box, and an encoder has constant camera matrices; for a robot that travels both are meant in
this frame, which is therefore where ``camera_from_world``, projections and points are taken to before they reach them.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from nerf_rl.files.structure import mapping, one_of, text

AXES = ("xy", "xyz")
TRACKING_FRAME_STRUCTURE = mapping({"body": text(), "axes": one_of(*AXES)})
"""of :meth:`TrackingFrame.to_json`, in a file that somebody handed in"""


@dataclass(frozen=True)
class TrackingFrame:
    """Which body the frame goes with, and along which axes."""

    body: str
    """its name"""
    axes: str = AXES[0]
    """``xy``: horizontally; ``xyz``"""

    def origin(self, position: Float[ndarray, "*B 3"]) -> Float[ndarray, "*B 3"]:
        """Return where the frame's origin is in the world [m] when the body is at a position [m]."""
        return position * np.array([axis in self.axes for axis in "xyz"], np.float64)

    def to_json(self) -> dict[str, Any]:
        """Return what :meth:`from_json` reads."""
        return {"body": self.body, "axes": self.axes}

    @classmethod
    def from_json(cls, content: dict[str, Any] | None) -> "TrackingFrame | None":
        """Return the frame that a file describes, or None if it describes none."""
        return None if content is None else cls(content["body"], content["axes"])


def to_tracking_frame(
    camera_from_world: Float[ndarray, "*#B 4 4"], origin: Float[ndarray, "*#B 3"]
) -> Float[ndarray, "*B 4 4"]:
    """Return poses as they are in a tracking frame, whose origin is told in the world [m], from those in the world."""
    shape = np.broadcast_shapes(camera_from_world.shape[:-2], origin.shape[:-1])
    result = np.broadcast_to(camera_from_world, (*shape, 4, 4)).copy()
    result[..., :3, 3] += (camera_from_world[..., :3, :3] @ origin[..., None])[..., 0]
    return result


def to_world(camera_from_frame: Float[ndarray, "*#B 4 4"], origin: Float[ndarray, "*#B 3"]) -> Float[ndarray, "*B 4 4"]:
    """Return poses as they are in the world, from those in a tracking frame, whose origin is told in the world [m]."""
    return to_tracking_frame(camera_from_frame, -origin)
