"""Whether a run can go on from a checkpoint: it is compared with what this very run would write, before it is loaded.

Lightning puts a checkpoint's values into modules, optimisers and loops piece by piece; one that does not fit would end
the run somewhere in the middle of that, or later.
"""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import lightning
import torch
from torch import Tensor

from nerf_rl.datasets.storage.reader import MultiViewDataset
from nerf_rl.errors import BEGIN_ANEW, MissingFileError, UserError
from nerf_rl.files.structure import StructureError, mapping, number, table, text, whole
from nerf_rl.files.tensor_files import tensor_fault
from nerf_rl.pretrain.model.checkpoint_file import DATASET, read_checkpoint

_MOMENTS = ("exp_avg", "exp_avg_sq")
_STRUCTURE = mapping(
    {
        "epoch": whole(),
        "global_step": whole(),
        "seconds": number(0.0),
        "pytorch-lightning_version": text(r"2\.\d+\.\d+\S*", "a version 2 of Lightning"),
    },
    others=True,
)
_CALLBACK = mapping(
    {},
    {"best_model_path": text(), "kth_best_model_path": text(), "last_model_path": text(), "dirpath": text()},
    others=True,
)


def require_resumable(path: Path, module: lightning.LightningModule, trainer: lightning.Trainer) -> None:
    """Check that a checkpoint is one of this run.

    Args:
        path: of the checkpoint.
        module: as it is at the beginning of the run.
        trainer: that is to go on; the module is attached to it.

    Raises:
        MissingFileError: it is damaged, or of another run.
    """
    checkpoint = read_checkpoint(path)
    module.trainer = trainer
    try:
        _STRUCTURE(checkpoint, "")
        _same(checkpoint["state_dict"], module.state_dict(), "state_dict")
        table(_CALLBACK)(checkpoint.get("callbacks", {}), "callbacks")
        _check_loops(checkpoint.get("loops"), trainer)
        _check_optimiser(checkpoint, module)
    except ValueError as error:
        raise MissingFileError("a checkpoint to go on from", path, str(error), BEGIN_ANEW) from error


def require_same_dataset(path: Path, dataset: MultiViewDataset) -> None:
    """Check that a checkpoint is of a dataset, wherever that lies by now; those of earlier versions do not tell.

    Raises:
        MissingFileError: it is damaged.
        UserError: it is of another dataset, where things look otherwise or are elsewhere.
    """
    digest = dataset.digest()
    if read_checkpoint(path).get(DATASET, digest) != digest:
        raise UserError(f"{path} is of another dataset than {dataset.folder}; give that one, or use another --out")


def _check_loops(found: Any, trainer: lightning.Trainer) -> None:
    loops = {name: getattr(trainer, name) for name in ("fit_loop", "validate_loop", "test_loop", "predict_loop")}
    _same(found, {name: loop.state_dict() for name, loop in loops.items()}, "loops")


def _check_optimiser(checkpoint: Mapping[str, Any], module: lightning.LightningModule) -> None:
    configured: Any = module.configure_optimizers()
    optimiser, schedule = configured["optimizer"], configured["lr_scheduler"]["scheduler"]
    for name in ("optimizer_states", "lr_schedulers"):
        if not isinstance(checkpoint.get(name), list) or len(checkpoint[name]) != 1:
            raise StructureError(name, checkpoint.get(name), "a list of 1")
    state = checkpoint["optimizer_states"][0]
    mapping({"state": mapping({}, others=True), "param_groups": lambda *_: None})(state, "optimizer_states.0")
    _same(state["param_groups"], optimiser.state_dict()["param_groups"], "param_groups")
    parameters = [parameter for group in optimiser.param_groups for parameter in group["params"]]
    for index, moments in state["state"].items():
        if isinstance(index, bool) or not isinstance(index, int) or not 0 <= index < len(parameters):
            raise StructureError(
                "optimizer_states.0.state", index, f"the number of one of {len(parameters)} parameters"
            )
        like = dict.fromkeys(_MOMENTS, parameters[index].detach()) | {"step": torch.zeros(())}
        _same(moments, like, f"optimizer_states.0.state.{index}")
    _same(checkpoint["lr_schedulers"][0], schedule.state_dict(), "lr_schedulers.0")


def _same(found: Any, like: Any, place: str) -> None:
    """Raise ValueError unless a value is built as another one is: the same keys, lengths, shapes and kinds."""
    if isinstance(like, Tensor):
        fault = tensor_fault(found, like)
        if fault:
            raise StructureError(place, None if isinstance(found, Tensor) else found, f"as it should be: it {fault}")
    elif isinstance(like, Mapping):
        if not isinstance(found, Mapping):
            raise StructureError(place, found, "a mapping")
        if lacking := [key for key in like if key not in found]:
            raise ValueError(f"{place} lacks {', '.join(map(str, lacking))}")
        if strange := [key for key in found if key not in like]:
            raise ValueError(f"{place} has {', '.join(map(str, strange))}, which this version does not know")
        for key, value in like.items():
            _same(found[key], value, f"{place}.{key}")
    elif isinstance(like, (list, tuple)):
        if not isinstance(found, (list, tuple)) or len(found) != len(like):
            raise StructureError(place, found, f"a list of {len(like)}")
        for index, value in enumerate(like):
            _same(found[index], value, f"{place}.{index}")
    elif isinstance(like, bool):
        if not isinstance(found, bool):
            raise StructureError(place, found, "true or false")
    elif isinstance(like, (int, float)):
        (whole() if isinstance(like, int) else number(0.0))(found, place)
    elif type(found) is not type(like):
        raise StructureError(place, found, type(like).__name__)
