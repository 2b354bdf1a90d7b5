"""What stands still before a camera that stands still is drawn once, and put behind what moves by its depth.

On drawer-open, software OpenGL spends two fifths of a picture's time on what is the same in every picture. A pixel
shows what is nearest in either part, so that pictures are the same, to the last bit, as if all were drawn at once.
"""

import cv2
import mujoco
import numpy as np
from jaxtyping import Bool, Float, Shaped
from numpy import ndarray

from nerf_rl.scenes.workspace import undrawn

_OF_GEOMS = ("rgba", "size", "type", "group", "matid", "dataid")


class StillGeoms:
    """Tells which geoms have stood still for as long as the scene has looked as it does, and before which cameras.

    Args:
        model: appearance is read from it at each call.

    Attributes:
        still: the geoms [G].
        steady: the cameras of the last call that were there in the call before, too, in the same places [V]; none if
            the scene has changed since, so that one that looks otherwise each time is not drawn twice.
    """

    still: Bool[ndarray, "G"]
    steady: Bool[ndarray, "V"]

    def __init__(self, model: mujoco.MjModel):
        self._model = model
        names = [*(f"geom_{name}" for name in _OF_GEOMS), *(n for n in dir(model) if n.startswith(("mat_", "light_")))]
        self._arrays = [getattr(model, name) for name in names]
        self._appearance, self._version = b"", 0
        self._poses, self._cameras = np.empty((0, 12)), np.empty((0, 25))
        self.still, self.steady = np.zeros(model.ngeom, bool), np.zeros(0, bool)

    def forget(self) -> None:
        """Take the scene for one that looks otherwise, since OpenGL was given something anew."""
        self._appearance = b""

    def look(
        self, data: mujoco.MjData, intrinsics: Float[ndarray, "V 3 3"], camera_from_world: Float[ndarray, "V 4 4"]
    ) -> None:
        """Take in a state and the cameras that see it."""
        before, appearance = self._version, self._appearance_now(data)
        poses = np.concatenate([data.geom_xpos, data.geom_xmat], 1)
        if appearance != self._appearance:
            self._appearance, self._poses = appearance, poses
            self.still = np.full(len(poses), self._can_be_divided())
            self._version += 1
        still = self.still & (poses == self._poses).all(1)
        if still.sum() < self.still.sum():
            self.still = still
            self._version += 1
        cameras = np.concatenate([intrinsics.reshape(-1, 9), camera_from_world.reshape(-1, 16)], 1)
        both = min(len(cameras), len(self._cameras))
        self.steady = np.zeros(len(cameras), bool)
        if self._version == before and self.still.any():
            self.steady[:both] = (cameras[:both] == self._cameras[:both]).all(1)
        self._cameras = cameras

    def key(self, view: int) -> bytes:
        """Return what a picture of all that stands still depends on, for a view of the last call."""
        return self._version.to_bytes(8, "little") + self._cameras[view].tobytes()

    def _appearance_now(self, data: mujoco.MjData) -> bytes:
        """Return all that decides, beside poses and what OpenGL was given, how geoms look."""
        visual = self._model.vis
        lamp, colours = visual.headlight, visual.rgba
        arrays = [
            data.light_xpos,
            data.light_xdir,
            lamp.ambient,
            lamp.diffuse,
            lamp.specular,
            colours.fog,
            colours.haze,
        ]
        scalars = np.array([lamp.active, visual.map.haze, visual.map.znear, visual.map.zfar, self._model.stat.extent])
        return b"".join(array.tobytes() for array in (*self._arrays, *arrays, scalars))

    def _can_be_divided(self) -> bool:
        """Tell whether each pixel shows one geom and nothing else, none of which lets through what is behind it."""
        model = self._model
        drawn = ~undrawn(model)
        materials = model.geom_matid[drawn]
        alpha = np.concatenate([model.geom_rgba[drawn, 3], model.mat_rgba[materials[materials >= 0], 3]])
        opaque = np.isin(alpha, (0, 1)).all() and not (model.tex_nchannel == 4).any()
        tendons = (model.wrap_type != mujoco.mjtWrap.mjWRAP_JOINT).any()
        beams = (model.sensor_type == mujoco.mjtSensor.mjSENS_RANGEFINDER).any()
        return bool(opaque and not (tendons or beams or model.nskin or model.nflex))


class StillBackground:
    """Pictures of what stands still, one a view."""

    def __init__(self) -> None:
        self._kept: dict[int, tuple[bytes, ndarray, ndarray]] = {}

    def has(self, view: int, key: bytes) -> bool:
        """Tell whether there is a picture of a view for a key."""
        return view in self._kept and self._kept[view][0] == key

    def keep(self, view: int, key: bytes, pixels: Shaped[ndarray, "H W *C"], depth: Float[ndarray, "H W"]) -> None:
        """Keep a copy of a view's picture."""
        self._kept[view] = key, pixels.copy(), depth.copy()

    def put_behind(self, view: int, pixels: Shaped[ndarray, "H W *C"], depth: Float[ndarray, "H W"]) -> bool:
        """Put what stands still behind what moves, in a view's picture of the latter, in place.

        Returns:
            Whether that could be done. Where both are equally far, OpenGL shows what is drawn last, which is not known
            here; the picture is of no use then.
        """
        _, still, behind = self._kept[view]
        if ((behind == depth) & (depth > 0)).any():
            return False
        cv2.copyTo(still, (behind >= depth).view(np.uint8), pixels)
        np.maximum(depth, behind, out=depth)
        return True
