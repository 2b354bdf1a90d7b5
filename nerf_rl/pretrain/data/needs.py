"""What an objective needs of a dataset beside its pictures, and how to do without what an imported one lacks."""

from collections.abc import Iterator

from nerf_rl.datasets.storage.reader import MultiViewDataset
from nerf_rl.datasets.storage.stored_manifest import DEPTH, LABELS, STATE
from nerf_rl.errors import UserError
from nerf_rl.pretrain.config import ANCHORS, FIELD, SUPERVISED, TEACHERS, PretrainConfig

_NEEDED_OBJECTIVES = {"depth": (DEPTH,), SUPERVISED: (STATE,), ANCHORS: (DEPTH, LABELS)}
_MEASURED = {"miou": LABELS, "depth_mae_m": DEPTH}  # by --stop_when
_RECIPES = {
    (
        DEPTH,
        LABELS,
    ): "add --config pretrain/objectives/field-rgb.yaml after the recipe: it learns from colours alone",
    (DEPTH,): "add --config pretrain/objectives/field-semantic.yaml after the recipe: it learns without depth",
    (LABELS,): "set --losses.semantic 0 --losses.anchor 0, which learns from colours and depth",
}
_OTHERS = "choose --objective field with pretrain/objectives/field-rgb.yaml, autoencoder, masked or contrastive"


def require_modalities(dataset: MultiViewDataset, config: PretrainConfig) -> None:
    """Check that a dataset has what an objective learns from.

    Raises:
        UserError: it lacks depth, labels or state that is asked for; the message says what does without.
    """
    absent = set(dataset.absent)
    missing = [kind for kind in _NEEDED_OBJECTIVES.get(config.objective, ()) if kind in absent]
    if missing:
        what = " and no ".join(missing)
        raise UserError(f"{dataset.folder} has no {what}, which --objective {config.objective} learns from; {_OTHERS}")
    if config.objective == "depth" and dataset.read_valid([0]) is not None:
        raise UserError(
            f"{dataset.folder} has pixels of unknown depth or that are masked, which --objective depth cannot leave "
            f"out; {_OTHERS}"
        )
    if config.objective != FIELD:
        return
    asking = {kind: list(keys) for kind, keys in (("depth", _depth_keys(config)), ("labels", _label_keys(config)))}
    lacking = tuple(kind for kind in (DEPTH, LABELS) if kind in absent and asking[kind])
    if lacking:
        keys = ", ".join(dict.fromkeys(f"--{key}" for kind in lacking for key in asking[kind]))
        without = _RECIPES[tuple(kind for kind in (DEPTH, LABELS) if kind in absent)]
        raise UserError(f"{dataset.folder} has no {' and no '.join(lacking)}, which {keys} need; {without}")
    if config.stop_when:
        for measure, kind in _MEASURED.items():
            if config.stop_when.strip().startswith(measure) and kind in absent:
                raise UserError(f"--stop_when {config.stop_when}: {dataset.folder} has no {kind} to measure it by")


def _depth_keys(config: PretrainConfig) -> Iterator[str]:
    """Yield the keys that ask for depth."""
    for loss in ("depth", "anchor"):
        if getattr(config.losses, loss):
            yield f"losses.{loss}"
    for count in ("training_free_space", "training_surface"):
        if getattr(config.sampling, count):
            yield f"sampling.{count}"
    if config.losses.feature and set(config.teachers) & set(TEACHERS):
        yield "teachers"


def _label_keys(config: PretrainConfig) -> Iterator[str]:
    """Yield the keys that ask for labels."""
    for loss in ("semantic", "anchor"):
        if getattr(config.losses, loss):
            yield f"losses.{loss}"
