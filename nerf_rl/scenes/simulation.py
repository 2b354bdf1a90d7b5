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

    Gymnasium's own environments have them as ``model`` and ``data``. Of dm_control's physics they are ``model.ptr`` and
    ``data.ptr``; Shimmy has it as ``physics``, gym-aloha as ``_env.physics``, and MyoSuite as ``sim``.
    """
    inside: Any = env.unwrapped
    model, data = getattr(inside, "model", None), getattr(inside, "data", None)
    if isinstance(model, mujoco.MjModel) and isinstance(data, mujoco.MjData):
        return Simulation(model, data)
    for holder in (getattr(inside, "physics", None), _get(inside, "_env", "physics"), getattr(inside, "sim", None)):
        model, data = _get(holder, "model", "ptr"), _get(holder, "data", "ptr")
        if isinstance(model, mujoco.MjModel) and isinstance(data, mujoco.MjData):
            return Simulation(model, data)
    return None


def simulation_of(env: gymnasium.Env) -> Simulation:
    """Return the model and the state that an environment steps.

    Raises:
        TypeError: it keeps them nowhere that is known here.
    """
    found = find_simulation(env)
    if found is None:
        raise TypeError(f"{env} has no MuJoCo model and data, nor a physics of dm_control")
    return found


def _get(thing: Any, name: str, of_that: str) -> Any:
    return getattr(getattr(thing, name, None), of_that, None)
