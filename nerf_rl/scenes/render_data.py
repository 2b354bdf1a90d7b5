"""The state of a simulation as it is drawn: the one that ``qpos`` holds, wherever the simulation is in its step."""

import mujoco


class RenderData:
    """Propagates positions from a simulation's state, in a copy.

    After ``mj_step`` MuJoCo's positions are those of one substep before ``qpos``. They are propagated in a copy,
    because environments may read the old ones in their next step.

    Args:
        model: of the simulation; what has been moved in it is read at each call.

    Attributes:
        model: the same.
    """

    def __init__(self, model: mujoco.MjModel):
        self.model, self._copy = model, mujoco.MjData(model)

    def of(self, data: mujoco.MjData) -> mujoco.MjData:
        """Return a state to draw, which the next call overwrites; the simulation is untouched."""
        model, copy = self.model, self._copy
        copy.qpos[:], copy.qvel[:], copy.time = data.qpos, data.qvel, data.time
        copy.mocap_pos[:], copy.mocap_quat[:] = data.mocap_pos, data.mocap_quat
        mujoco.mj_kinematics(model, copy)
        mujoco.mj_comPos(model, copy)
        mujoco.mj_camlight(model, copy)
        mujoco.mj_flex(model, copy)
        mujoco.mj_tendon(model, copy)
        return copy
