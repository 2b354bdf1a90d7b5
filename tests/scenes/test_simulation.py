"""MuJoCo's model and state are found where packages keep them."""

from typing import Any

import gymnasium
import mujoco
import pytest

from nerf_rl.scenes.simulation import find_simulation, simulation_of

XML = "<mujoco><worldbody><body><freejoint/><geom size='0.1'/></body></worldbody></mujoco>"


class Keeper(gymnasium.Env):
    """An environment that keeps a simulation under a name, or inside what it has under a name."""

    def __init__(self, simulation: Any, *path: str):
        for name in reversed(path[1:]):
            simulation = type("Inside", (), {name: simulation})()
        setattr(self, path[0], simulation)


@pytest.mark.parametrize("path", [("physics",), ("_env", "physics"), ("sim",)])
def test_the_physics_of_dm_control_is_found(path: tuple[str, ...]):
    dm_mujoco = pytest.importorskip("dm_control.mujoco")
    physics = dm_mujoco.Physics.from_xml_string(XML)
    env = gymnasium.wrappers.TimeLimit(Keeper(physics, *path), 5)
    found = simulation_of(env)
    assert (found.model, found.data) == (physics.model.ptr, physics.data.ptr)
    physics.reload_from_xml_string(XML.replace("0.1", "0.2"))  # as dm_control's composer does at resets
    assert simulation_of(env).model.geom_size[0, 0] == 0.2


def test_an_environments_own_model_and_data_are_found_and_of_another_kind_are_not():
    env = Keeper(mujoco.MjModel.from_xml_string(XML), "model")
    assert find_simulation(env) is None
    env.data = mujoco.MjData(env.model)  # type: ignore[attr-defined]
    assert simulation_of(env) == (env.model, env.data)  # type: ignore[attr-defined]
    with pytest.raises(TypeError, match="has no MuJoCo model and data"):
        simulation_of(gymnasium.make("CartPole-v1"))
