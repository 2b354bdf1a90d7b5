"""Whether a dataset shows what an objective learns from: found out before anything is written, and again in a run."""

from nerf_rl.datasets.storage.reader import MultiViewDataset
from nerf_rl.errors import UserError
from nerf_rl.pretrain.config import ANCHORS, SUPERVISED, PretrainConfig
from nerf_rl.pretrain.data.anchors import Anchors
from nerf_rl.pretrain.data.statistics import measure
from nerf_rl.pretrain.data.view_batches import standardised_state


def require_learnable(dataset: MultiViewDataset, config: PretrainConfig) -> None:
    """Look at some training frames, as a run does when it begins.

    Raises:
        UserError: the encoder's cameras see nothing, the limits of the recipe contradict what they see, or nothing
            that the objective learns from moves.
    """
    require_targets(dataset, config, measure(dataset, config).anchors)


def require_targets(dataset: MultiViewDataset, config: PretrainConfig, anchors: Anchors) -> None:
    """Check that something moves, of what the objective learns where it is.

    Raises:
        UserError: no class does, or no column of the true state.
    """
    if config.objective == ANCHORS and not anchors.classes:
        raise UserError(f"{dataset.folder} shows no class that moves, which --objective {ANCHORS} learns from")
    if config.objective == SUPERVISED and not standardised_state(dataset)[0]:
        names = ", ".join(dataset.columns("privileged")) or "there is none"
        raise UserError(
            f"no column of the true state of {dataset.folder} ({names}) varies as its encoder's cameras see it, "
            f"which --objective {SUPERVISED} learns from"
        )
