"""Where an environment keeps MuJoCo's model and state."""

from typing import Any, NamedTuple

import gymnasium
import mujoco


class Simulation(NamedTuple):
    """MuJoCo's model and state inside an environment, until it compiles another model."""

    model: mujoco.MjModel
    data: mujoco.MjData


def find_simulation(env: gymnasium.Env) -> Simulation | None:
    """Return the model and the state that an environment steps, or None if it keeps them nowhere that is known here.

    Gymnasium's own environments have them as ``model`` and ``data``. Those of dm_control have a ``physics`` whose
    ``model.ptr`` and ``data.ptr`` they are, inside ``_env`` as Shimmy and gym-aloha wrap them.
    """
    inside: Any = env.unwrapped
    model, data = getattr(inside, "model", None), getattr(inside, "data", None)
    if not isinstance(model, mujoco.MjModel):
        physics = getattr(getattr(inside, "_env", inside), "physics", None)
        model, data = (getattr(getattr(physics, name, None), "ptr", None) for name in ("model", "data"))
    found = isinstance(model, mujoco.MjModel) and isinstance(data, mujoco.MjData)
    return Simulation(model, data) if found else None


def simulation_of(env: gymnasium.Env) -> Simulation:
    """Return the model and the state that an environment steps.

    Raises:
        TypeError: it keeps them nowhere that is known here.
    """
    found = find_simulation(env)
    if found is None:
        raise TypeError(f"{env} has no MuJoCo model and data, nor a physics of dm_control")
    return found
