"""Where in a scene something happens: the ball that cameras are fitted to."""

from dataclasses import dataclass

import mujoco
import numpy as np
from jaxtyping import Bool, Float, Float32
from numpy import ndarray

DRAWN_GROUPS = 3  # MuJoCo draws geoms of groups 0, 1 and 2
_DEFAULT_COLOUR = (0.5, 0.5, 0.5, 1.0)  # of geoms in MJCF
_ALIKE = 0.9  # of a shape's radius, from which on others may be what it stands for in collisions


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


def drawn_geoms(model: mujoco.MjModel) -> list[int]:
    """Return the geoms that can be seen."""
    return np.flatnonzero(~undrawn(model) & (opacity(model) > 0)).tolist()


def opacity(model: mujoco.MjModel) -> Float32[ndarray, "G"]:
    """Return how opaque geoms are drawn: as their material is, unless they have a colour of their own.

    That is MuJoCo's rule (``setMaterial`` in engine_vis_visualize.c); to have MJCF's default colour is to have none.
    """
    own, material = model.geom_rgba, model.geom_matid
    goes_by_material = (material >= 0) & (own == np.array(_DEFAULT_COLOUR, np.float32)).all(1)
    alpha = own[:, 3].copy()
    alpha[goes_by_material] = model.mat_rgba[material[goes_by_material], 3]
    return alpha


def undrawn(model: mujoco.MjModel) -> Bool[ndarray, "G"]:
    """Tell which geoms no camera is to see: those of hidden groups, and of drawn ones that are for collisions alone.

    Robosuite keeps shapes for collisions in group 0, in green, and in group 1 what bodies look like. So a group whose
    geoms of bodies all collide is hidden with them if most have a body with others, drawn and of another group, that
    collide with nothing and are about as large together, which a mark on it is not.
    """
    drawn, collides = model.geom_group < DRAWN_GROUPS, (model.geom_contype | model.geom_conaffinity) != 0
    to_look_at = np.flatnonzero(drawn & ~collides & (opacity(model) > 0))
    radii = np.zeros((model.nbody, DRAWN_GROUPS))  # of what a body has to look at alone, by group
    np.add.at(radii, (model.geom_bodyid[to_look_at], model.geom_group[to_look_at]), model.geom_rbound[to_look_at])
    others = (radii[model.geom_bodyid] * (np.arange(DRAWN_GROUPS) != model.geom_group[:, None])).sum(1)
    looks_otherwise = (others > 0) & (others >= _ALIKE * model.geom_rbound)
    hidden = ~drawn
    for group in range(DRAWN_GROUPS):
        members = (model.geom_group == group) & (model.geom_bodyid > 0)  # the world is not one thing
        if members.any() and collides[members].all() and 2 * looks_otherwise[members].sum() > members.sum():
            hidden |= members
    return hidden


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
    drawn = [geom for geom in drawn_geoms(model) if model.geom_rbound[geom] > 0]
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
