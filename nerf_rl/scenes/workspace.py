"""Where in a scene something happens: the ball that cameras are fitted to."""

from dataclasses import dataclass

import mujoco
import numpy as np
from jaxtyping import Float
from numpy import ndarray

DRAWN_GROUPS = 3  # MuJoCo draws geoms of groups 0, 1 and 2


@dataclass(frozen=True)
class Workspace:
    """A ball around what moves.

    Attributes:
        centre: in the world, at first [m].
        radius: of the ball [m].
        floating_base: body that may carry the ball away horizontally, such as the torso of a robot that walks; empty if
            there is none.
        from_floating_base: where the middle is at first, as seen from that body, in the world's axes [m].
        facing: heading in which an arm looks at the ball from its base [degrees]; None if none stands beside it.
    """

    centre: Float[ndarray, "3"]
    radius: float
    floating_base: str = ""
    from_floating_base: tuple[float, float, float] = (0.0, 0.0, 0.0)
    facing: float | None = None

    @property
    def turn(self) -> float:
        """By what to turn a camera's azimuth so that one of 90 looks the arm in the face [degrees]; 0 without one."""
        return 0.0 if self.facing is None else self.facing - 270.0

    def centre_in(self, data: mujoco.MjData) -> Float[ndarray, "3"]:
        """Return where the middle is in a state whose positions are propagated, gone with the floating base [m]."""
        if not self.floating_base:
            return self.centre
        gone = data.body(self.floating_base).xpos + np.array(self.from_floating_base)
        return np.array([*gone[:2], self.centre[2]])

    def distance(self, fovy_deg: float) -> float:
        """Return from how far a camera with this field of view [degrees] sees the whole ball [m]."""
        return self.radius / float(np.sin(np.deg2rad(fovy_deg) / 2.0))


def is_drawn(model: mujoco.MjModel, geom: int) -> bool:
    """Tell whether a geom can be seen."""
    return bool(model.geom_group[geom] < DRAWN_GROUPS and model.geom_rgba[geom, 3] > 0)


def fit_workspace(model: mujoco.MjModel, data: mujoco.MjData) -> Workspace:
    """Return the ball around all drawn geoms of bodies that can move, or around all geoms that end if nothing moves.

    Args:
        model: of the scene.
        data: its state, with positions propagated.
    """
    centres, radii = moving_balls(model, data)
    return around(centres[None], radii, 0.0) if len(radii) else Workspace(*_of_the_model(model))


def moving_balls(
    model: mujoco.MjModel, data: mujoco.MjData, placed: tuple[int, ...] = ()
) -> tuple[Float[ndarray, "G 3"], Float[ndarray, "G"]]:
    """Return centres and radii [m] of the geoms of :func:`moving_geoms`.

    Args:
        model: of the scene.
        data: its state, with positions propagated.
        placed: as there.
    """
    chosen = moving_geoms(model, placed)
    return data.geom_xpos[chosen].copy(), model.geom_rbound[chosen].copy()


def moving_geoms(model: mujoco.MjModel, placed: tuple[int, ...] = ()) -> list[int]:
    """Return the drawn geoms of bodies that can move, and those that are placed, or all that end if there are none."""
    drawn = [geom for geom in range(model.ngeom) if is_drawn(model, geom) and model.geom_rbound[geom] > 0]
    return [geom for geom in drawn if model.body_weldid[model.geom_bodyid[geom]] != 0 or geom in placed] or drawn


def around(centres: Float[ndarray, "T G 3"], radii: Float[ndarray, "G"], left_out: float) -> Workspace:
    """Return a ball around geoms in T states.

    Args:
        centres: of the geoms [m].
        radii: of balls around them [m].
        left_out: share of places that may be outside on each side, such as those of what fell off a table.
    """
    reach = radii[:, None]
    low = np.quantile(centres - reach, left_out, axis=(0, 1))
    high = np.quantile(centres + reach, 1.0 - left_out, axis=(0, 1))
    centre = (low + high) / 2.0
    distances = np.linalg.norm(centres - centre, axis=-1) + radii
    return Workspace(centre, float(np.quantile(distances, 1.0 - left_out)))


def _of_the_model(model: mujoco.MjModel) -> tuple[Float[ndarray, "3"], float]:
    return np.array(model.stat.center, np.float64), float(model.stat.extent)
