"""What a run leaves behind while it goes on and at its end: policy, learning curve and ``summary.json``."""

import sys
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol, runtime_checkable

from nerf_rl.files.json_files import write_json
from nerf_rl.files.outputs import SUMMARY
from nerf_rl.machine.memory import peak_rss_mb
from nerf_rl.rl.agents.policy_file import encoder_digest
from nerf_rl.rl.config import NetworkConfig, TrainRLConfig
from nerf_rl.rl.training.evaluation_results import DEMONSTRATIONS

if TYPE_CHECKING:
    from torch import nn

    from nerf_rl.rl.agents.networks import LayeredConfig
    from nerf_rl.rl.environments.make import EnvSpec

OnEvaluation = Callable[[dict[str, Any]], None]
CURVE = "learning_curve.png"


@runtime_checkable
class TrainingState(Protocol):
    """What the trainers of all algorithms tell about a run so far."""

    env_steps: int
    """environment steps"""
    episodes: int
    """training episodes that have ended or were broken off"""
    evaluations: list[dict[str, Any]]
    """results so far, as in ``summary.json``"""

    @property
    def seconds(self) -> float:
        """Time spent so far [s]."""


class RunRecord:
    """Writes the results of a run of ``train-rl``.

    Args:
        config: of the run.
        spec: of its environments.
        sizes: of observation and action.
        proprio_names: what the policy observes beside the latent.
        on_evaluation: called with each evaluation, after the policy of then has been written.
    """

    def __init__(
        self,
        config: TrainRLConfig,
        spec: "EnvSpec",
        sizes: tuple[int, int],
        proprio_names: list[str],
        on_evaluation: OnEvaluation | None = None,
    ):
        self._on_evaluation = on_evaluation
        self._config, self._spec, self._sizes, self._proprio_names = config, spec, sizes, proprio_names
        self._run = Path(config.out)
        self._digest = encoder_digest(spec.encoder) if spec.encoder else None

    def keep(self, actor: "nn.Sequential", network: "NetworkConfig | LayeredConfig", state: TrainingState) -> None:
        """Write the policy (from raw observations to actions), draw the learning curve, tell ``on_evaluation``."""
        from nerf_rl.rl.agents.policy import Policy
        from nerf_rl.rl.training.curves import draw_learning_curve

        policy = Policy(actor, self._spec, network, *self._sizes, self._proprio_names, self._digest, state.env_steps)
        policy.demonstrations, policy.to_end = self._config.demonstrations, self._config.evaluation_to_end
        # a run that had ended and goes on has one, which tells of another policy
        (self._run / SUMMARY).unlink(missing_ok=True)
        policy.save(self._run)
        draw_learning_curve(self._run / CURVE, state.evaluations, self._config.scene)
        if self._on_evaluation is not None:
            self._on_evaluation(state.evaluations[-1])

    def finish(
        self,
        state: TrainingState,
        updates: int,
        workers: Sequence[Any],
        demonstrated: Mapping[str, int] | None = None,
    ) -> dict[str, Any]:
        """Write and return the summary; memory is the peak of this process plus those of its workers.

        Args:
            state: the trainer.
            updates: of the networks.
            workers: processes of the environments.
            demonstrated: what the demonstrations cost, whose environment steps are part of the run's.
        """
        if updates == 0:
            print(f"warning: nothing was learnt in {state.env_steps} env steps: there was no update", file=sys.stderr)
        shown = {} if demonstrated is None else {DEMONSTRATIONS: {**demonstrated, "in_env_steps": True}}
        summary = {
            "env_steps": state.env_steps,
            **shown,
            "episodes": state.episodes,
            "updates": updates,
            "seconds": round(state.seconds, 1),
            "peak_rss_mb": round(peak_rss_mb() + sum(_peak_rss_mb(worker.pid) for worker in workers), 1),
            "evaluations": state.evaluations,
        }
        write_json(self._run / SUMMARY, summary)  # last, so that a run with a summary is finished
        return summary


def _peak_rss_mb(pid: int) -> float:
    """Return the peak resident memory of another process [MB]; 0 where Linux's /proc does not tell."""
    try:
        status = Path(f"/proc/{pid}/status").read_text()
    except OSError:
        return 0.0
    return next((int(line.split()[1]) / 1024 for line in status.splitlines() if line.startswith("VmHWM")), 0.0)
