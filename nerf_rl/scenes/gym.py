"""Any Gymnasium environment on MuJoCo as a scene."""

import traceback
import warnings
from importlib.metadata import version
from typing import Any

import gymnasium
from gymnasium.envs.registration import registry

from nerf_rl.errors import FailureError, UnknownNameError, UserError
from nerf_rl.scenes.base import GYM
from nerf_rl.scenes.simulation import find_simulation
from nerf_rl.scenes.structured import StructuredScene

_MUJOCO_ENTRY = "mujoco"


class GymScene(StructuredScene):
    """A Gymnasium environment on MuJoCo, whose model and state :func:`nerf_rl.scenes.simulation.find_simulation` finds.

    Args:
        name: its id, such as ``Ant-v5``, or ``MODULE:ID`` if a module has to be imported first to register it.

    Raises:
        UserError: there is no such environment, it cannot be made, or it is not on MuJoCo.
    """

    def __init__(self, name: str):
        self.name = GYM + name
        module, _, bare = name.rpartition(":")
        if not module and bare not in registry:
            known = [key for key, spec in registry.items() if _MUJOCO_ENTRY in str(spec.entry_point)]
            raise UnknownNameError("Gymnasium environment on MuJoCo", bare, known)
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")  # on versions of environments, and on observations beyond the space
                self.env = _ToldErrors(gymnasium.make(name, disable_env_checker=True), self.name)
        except Exception as error:  # environments raise all sorts of things for packages that they miss
            raise UserError(
                f"Gymnasium environment '{name}' cannot be made: {_words(error) or _place(error)}"
            ) from error
        if find_simulation(self.env) is None:
            raise UserError(f"Gymnasium environment '{name}' is not on MuJoCo: it has no mujoco.MjModel")
        super().__init__()

    def observation(self) -> Any:
        """Return the environment's observation of its present state, or nothing if it cannot tell."""
        observe = getattr(self.env.unwrapped, "_get_obs", None)
        return None if observe is None else observe()

    def provenance(self) -> dict[str, Any]:
        """Return name, versions and the digest of the model."""
        return {**super().provenance(), "gymnasium": version("gymnasium")}


class _ToldErrors(gymnasium.Wrapper):
    """Says in a sentence what went wrong inside an environment, and where, such as a simulation that diverged."""

    def __init__(self, env: gymnasium.Env, scene: str):
        super().__init__(env)
        self._scene = scene

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        try:
            return self.env.reset(seed=seed, options=options)
        except Exception as error:
            raise self._told(error, "reset") from error

    def step(self, action: Any) -> tuple[Any, Any, bool, bool, dict[str, Any]]:
        try:
            return self.env.step(action)
        except Exception as error:
            raise self._told(error, "step") from error

    def _told(self, error: Exception, call: str) -> FailureError:
        return FailureError(f"{self._scene} cannot {call}: {': '.join(filter(None, (_place(error), _words(error))))}")


def _place(error: Exception) -> str:
    """Return what an exception is and where it was raised."""
    place = traceback.extract_tb(error.__traceback__)[-1]
    return f"{type(error).__name__} in {place.filename}, line {place.lineno}"


def _words(error: Exception) -> str:
    """Return what an exception says, in one line; a bare assertion says nothing."""
    return " ".join(str(error).split())
