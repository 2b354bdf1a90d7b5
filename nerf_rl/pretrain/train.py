"""``nerf-rl pretrain``: check the input, train, measure, export."""

import sys
import time
from pathlib import Path

from nerf_rl.arguments.stored_keys import require_same_keys
from nerf_rl.datasets.storage.reader import MultiViewDataset
from nerf_rl.datasets.storage.shards import SPLIT_NAMES
from nerf_rl.datasets.storage.stored_manifest import IMPORTED_FROM
from nerf_rl.errors import UserError
from nerf_rl.files.json_files import write_json
from nerf_rl.files.outputs import SUMMARY, check_output, prepare_output, require_outside, write_provenance
from nerf_rl.loggers import require_loggers
from nerf_rl.machine.memory import peak_rss_mb
from nerf_rl.machine.threads import wait_passively
from nerf_rl.pretrain.config import PretrainConfig
from nerf_rl.pretrain.data.needs import require_modalities
from nerf_rl.pretrain.data.teachers import find_teacher
from nerf_rl.pretrain.execution.launch import rank_from_outside, run_on_each_device
from nerf_rl.pretrain.measures.figures import describe_hardly_shown, describe_validation, hardly_shown
from nerf_rl.pretrain.model.encoder_file import CHECKPOINT
from nerf_rl.pretrain.model.encoder_rig import EncoderRig


def pretrain(config: PretrainConfig) -> None:
    """Train an encoder on a dataset and export it into ``config.out``.

    Raises:
        UserError: no dataset, too few frames, cameras that do not move together, depth or labels that an imported
            dataset lacks, nothing to learn from, pictures smaller than a patch, devices that there are not, an output
            folder in use, or another dataset than the run was begun on.
    """
    dataset = MultiViewDataset(config.data)
    kept, held = (len(dataset.split(name)) for name in SPLIT_NAMES)
    if min(kept, held) < 2:  # probes need two
        more = (
            "import more moments, or" if IMPORTED_FROM in dataset.manifest["config"] else "generate more episodes, or"
        )
        raise UserError(
            f"{config.data} needs training and validation frames, two of each at least, and has {kept} and {held}; "
            f"{more} hold out another share of them (--validation_fraction)"
        )
    rig = EncoderRig.of_dataset(dataset)
    config.encoder.cells(min(rig.height, rig.width))
    require_modalities(dataset, config)
    for name in config.teachers:
        find_teacher(name)
    require_loggers(config.loggers)
    rank = rank_from_outside(config)
    wait_passively()
    if config.accelerator == "gpu" or config.devices > 1:
        from nerf_rl.pretrain.execution.placement import choose_accelerator  # PyTorch takes seconds to import

        choose_accelerator(config.accelerator, config.devices)
    folder = Path(config.out)
    resumable = (folder / CHECKPOINT).is_file()
    if not rank:  # the first of several processes, or the only one
        if config.resume and resumable:
            from nerf_rl.pretrain.resuming import require_same_dataset  # it imports PyTorch

            require_same_keys(folder, config.content(), PretrainConfig)
            require_same_dataset(folder / CHECKPOINT, dataset)
        require_outside(folder, config.data)
        check_output(folder, config.overwrite, config.resume, resumable, "pretrain")
        if not (config.resume and resumable):
            from nerf_rl.pretrain.data.learnable import require_learnable  # it imports PyTorch

            require_learnable(dataset, config)
        prepare_output(folder, config.overwrite, config.resume, resumable, "pretrain")
        write_provenance(folder, "pretrain", config)
        print(f"training on {kept} frames of {config.data}, {held} more held out; writing to {folder}", flush=True)
    checkpoint = folder / CHECKPOINT if config.resume and resumable else None
    if rank is None and config.processes > 1:
        run_on_each_device(config, train, checkpoint)
    else:
        train(config, checkpoint)


def train(config: PretrainConfig, checkpoint: Path | None) -> None:
    """Do this process's part of a run; the first of its processes writes and prints what came out.

    Args:
        config: of the run, whose folder is prepared.
        checkpoint: to go on from.
    """
    from nerf_rl.pretrain.fitting import fit  # PyTorch and Lightning take seconds to import; mistakes are told before

    started = time.monotonic()
    folder = Path(config.out)
    result = fit(config, MultiViewDataset(config.data), folder, checkpoint)
    if result is None:
        return
    missing = hardly_shown(result.class_iou, result.class_share)
    summary = {
        "steps": result.steps,
        "seconds": round(time.monotonic() - started, 1),
        "training_seconds": round(result.training_seconds, 1),
        "peak_rss_mb": round(peak_rss_mb(), 1),
        "device": result.device,
        "processes": config.processes,
        "precision": result.precision,
        "validation": result.validation,
        "class_iou": result.class_iou,
        "class_share": {name: round(share, 5) for name, share in result.class_share.items()},
        "hardly_shown": missing,
        "validation_other_cameras": result.other_cameras,
        **result.probe.summary(),
    }
    write_json(folder / SUMMARY, summary)
    print(f"{folder}: {result.steps} steps, {describe_validation(result.validation)}")
    for role, figures in result.other_cameras.items():
        print(f"from {role} cameras: {describe_validation(figures)}")
    print(result.probe.table())
    if missing:
        print(f"warning: {describe_hardly_shown(missing, result.class_iou)}", file=sys.stderr)
