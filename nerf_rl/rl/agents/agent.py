"""What the training loop asks of an algorithm that learns from replay, and which there are."""

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Protocol, runtime_checkable

from jaxtyping import Float
from numpy import ndarray

from nerf_rl.errors import UserError
from nerf_rl.machine.extras import find_named, make_named
from nerf_rl.rl.agents.ddpg import DDPG
from nerf_rl.rl.config import TrainRLConfig

if TYPE_CHECKING:
    import torch
    from torch import Tensor, nn

    from nerf_rl.rl.experience.replay import Replay

Metrics = dict[str, float]


@runtime_checkable
class Agent(Protocol):
    """An algorithm that learns from replay."""

    updates: int
    """how many :meth:`update` has done; the loop sets it where a run goes on"""

    def act(self, observation: Float[ndarray, "E O"]) -> Float[ndarray, "E A"]:
        """Return the policy's actions in [-1, 1], without noise."""

    def update_statistics(self, observation: Float[ndarray, "E O"]) -> None:
        """Take fresh observations into whatever standardises them."""

    def update(self, replay: "Replay", beta: float) -> Metrics:
        """Learn from one batch and give it new priorities; return what happened, by the names of ``metrics.csv``.

        Args:
            replay: to draw from.
            beta: exponent of the importance weights.
        """

    def diagnose(self, replay: "Replay") -> Metrics:
        """Return signs of trouble, by the names of ``metrics.csv``; it is asked once for each row of it."""

    def reset(self) -> None:
        """Start anew with fresh networks; what was counted and what standardises observations stays."""

    def policy(self) -> "nn.Sequential":
        """Return the network that is evaluated and kept, from raw observations to actions.

        It is that of :meth:`act`, or an average of what that was; its layers are ``--network``'s.
        """

    def state_dict(self) -> "dict[str, Tensor]":
        """Return all that a resumed run needs, by flat names."""

    def load_state_dict(self, tensors: "Mapping[str, Tensor]", source: Path) -> None:
        """Put back what :meth:`state_dict` returned; raise MissingFileError, naming ``source``, if it does not fit."""


@runtime_checkable
class CloningAgent(Agent, Protocol):
    """An algorithm that can also begin with demonstrations."""

    def clone(self, replay: "Replay") -> Metrics:
        """Take a step towards the demonstrations in memory; return what happened, with ``clone_error`` among it."""


@runtime_checkable
class ValuingAgent(Agent, Protocol):
    """An algorithm that can learn from what episodes brought."""

    def value(self, observation: Float[ndarray, "O"]) -> float:
        """Return the discounted rewards that are to be expected from an observation on."""


AgentClass = Callable[..., Agent]
"""Makes an agent of sizes of observation and action, the keys of ``network`` and ``learner``, and a device."""

AGENTS: dict[str, AgentClass] = {"ddpg": DDPG}


def find_agent(name: str, cloning: bool = False, valuing: bool = False) -> AgentClass:
    """Return an algorithm by its name, or one of the user's own by ``module:Class``.

    Args:
        name: of it.
        cloning: whether it has to be a :class:`CloningAgent`.
        valuing: whether it has to be a :class:`ValuingAgent`.

    Raises:
        UserError: the module cannot be imported, or its class lacks what the loop asks for.
    """
    if name in AGENTS:
        return AGENTS[name]
    found: AgentClass = find_named("algorithm", name)
    asked = [part for part in vars(Agent) if not part.startswith("_") and callable(getattr(Agent, part))]
    asked += ["clone"] if cloning else []
    asked += ["value"] if valuing else []
    missing = [part for part in asked if not callable(getattr(found, part, None))]
    if missing:
        raise UserError(f"'{name}' is no algorithm: it lacks {', '.join(missing)}")
    return found


def make_agent(
    config: TrainRLConfig, observation_size: int, action_size: int, device: "torch.device | str | None" = None
) -> Agent:
    """Return the agent that a run's keys describe, as it is at the beginning.

    Raises:
        UserError: an algorithm of the user's own cannot be had.
    """
    arguments = (observation_size, action_size, config.network, config.learner, device)
    if config.algo in AGENTS:
        return AGENTS[config.algo](*arguments)
    find_agent(config.algo)
    agent: Agent = make_named("algorithm", config.algo, *arguments)
    return agent
