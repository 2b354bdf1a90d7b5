"""How a run begins with demonstrations: they are acted, kept in memory for good, and the agent is cloned from them."""

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import gymnasium

from nerf_rl.errors import FailureError, UserError
from nerf_rl.rl.agents.agent import Agent, CloningAgent
from nerf_rl.rl.config import TrainRLConfig
from nerf_rl.rl.experience.replay import Replay
from nerf_rl.rl.training.demonstrations import act_demonstrations

Gather = Callable[[dict[str, float]], None]
"""Takes in scalars for ``metrics.csv`` and the loggers."""


class DemonstratedStart:
    """The demonstrations of a run; one without any has nothing to do here.

    Args:
        config: of the run.

    Attributes:
        cost: how many ``episodes`` are kept, and the ``tries`` and ``env_steps`` that they took, failures included, as
            in ``summary.json``; None as long as there are none.
    """

    def __init__(self, config: TrainRLConfig):
        self._config = config
        self.cost: dict[str, int] | None = None
        self._cloned = False

    @property
    def env_steps(self) -> int:
        """Environment steps that the demonstrations took, which are part of the run's."""
        return self.cost["env_steps"] if self.cost is not None else 0

    def act(self, envs: gymnasium.vector.VectorEnv, agent: Agent, replay: Replay) -> str:
        """Have the demonstrations acted, unless there are none to be or a checkpoint held them; tell of them.

        Raises:
            FailureError: the script hardly ever succeeds, or takes all of the run's environment steps.
        """
        config = self._config
        if not config.demonstrations or self.cost is not None:
            return ""
        acted = act_demonstrations(
            envs, config.demonstrations, config.demonstration_noise, config.seed, config.success_bonus
        )
        told = f"{len(acted.kept)} demonstrations took {acted.tries} tries and {acted.env_steps} env steps"
        if acted.env_steps + config.warmup_steps >= config.env_steps:
            raise FailureError(f"{told}, which leaves nothing of --env_steps {config.env_steps} to learn in")
        for episode in acted.kept:
            agent.update_statistics(episode.observations)
            replay.demonstrate(episode.transitions(config.learner.n_step, config.learner.gamma))
        self.cost = {"episodes": len(acted.kept), "tries": acted.tries, "env_steps": acted.env_steps}
        return told

    def clone(self, agent: Agent, replay: Replay, gather: Gather) -> None:
        """Let an agent that is to learn begin where the demonstrations end; once, until :meth:`forget`.

        Not before the warm-up is over: until then, each step changes much of what observations are standardised by.
        """
        if self._cloned or not self._config.demonstrations:
            return
        assert isinstance(agent, CloningAgent)
        for _ in range(self._config.learner.clone_steps):
            gather(agent.clone(replay))
        self._cloned = True

    def forget(self) -> None:
        """Tell that the agent starts anew, with fresh networks."""
        self._cloned = False

    def state_dict(self) -> dict[str, Any]:
        """Return what a resumed run needs beside memory, for its checkpoint."""
        return {} if self.cost is None else {"demonstrations": {**self.cost, "cloned": self._cloned}}

    def load_state_dict(self, facts: Mapping[str, Any], replay: Replay, source: Path) -> None:
        """Put back what :meth:`state_dict` returned.

        Args:
            facts: of a checkpoint.
            replay: as the checkpoint had it.
            source: the checkpoint, to be named.

        Raises:
            UserError: it has not the demonstrations that the run began with.
        """
        state = dict(facts.get("demonstrations", {}))
        if len({bool(state), replay.demonstrations > 0, self._config.demonstrations > 0}) > 1:
            raise UserError(f"{source} is damaged in its demonstrations; train again with --overwrite true")
        if state:
            self._cloned = state.pop("cloned")
            self.cost = state
