"""Where pictures begin: MuJoCo's near plane, unless that would cut off what moves."""

import mujoco

from nerf_rl.scenes.workspace import fit_workspace

_MOST = 0.5  # of the radius of what moves; in Gymnasium's and Meta-World's models the plane is at a tenth or nearer


def near_plane(model: mujoco.MjModel) -> float:
    """Return how far in front of a camera a picture begins [m].

    MuJoCo places the near plane by the size of the whole model. Around a ground of 60 m that is 0.85 m, and a camera
    fitted to a hand of 20 cm stands nearer than that. Where the plane is farther than half of the radius of what moves,
    it is placed by the size of what moves. The model alone decides that, so that what an encoder learnt from and what
    it sees later begin at the same distance.
    """
    near = float(model.vis.map.znear * model.stat.extent)
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    radius = fit_workspace(model, data).radius
    if near <= _MOST * radius or radius <= 0:
        return near
    return min(float(model.vis.map.znear) * 2.0 * radius, _MOST * radius)
