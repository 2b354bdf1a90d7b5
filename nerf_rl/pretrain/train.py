"""``nerf-rl pretrain``: check the input, train, measure, export."""

import time
from pathlib import Path

from nerf_rl.datasets.reader import MultiViewDataset
from nerf_rl.datasets.shards import SPLIT_NAMES
from nerf_rl.errors import UserError
from nerf_rl.pretrain.config import PretrainConfig
from nerf_rl.pretrain.encoder_rig import EncoderRig
from nerf_rl.runs import SUMMARY, peak_rss_mb, prepare_output, require_same_keys, write_json, write_provenance
from nerf_rl.threads import yield_while_waiting

CHECKPOINT = Path("checkpoints") / "last.ckpt"


def pretrain(config: PretrainConfig) -> None:
    """Train an encoder on a dataset and export it into ``config.out``.

    Raises:
        UserError: no dataset, too few frames, cameras that move, or an output folder in use.
    """
    dataset = MultiViewDataset(config.data)
    if min(len(dataset.split(name)) for name in SPLIT_NAMES) < 2:  # probes need two
        raise UserError(f"{config.data} needs training and validation frames; generate more than one episode")
    EncoderRig.of_dataset(dataset)
    folder = Path(config.out)
    resumable = (folder / CHECKPOINT).is_file()
    if config.resume and resumable:
        require_same_keys(folder, config.content())
    prepare_output(folder, config.overwrite, config.resume, resumable, "pretrain")
    write_provenance(folder, "pretrain", config)

    yield_while_waiting()
    from nerf_rl.pretrain.fitting import fit  # PyTorch and Lightning take seconds to import; mistakes are told before

    started = time.monotonic()
    print(f"training on {len(dataset)} frames of {config.data}; writing to {folder}")
    result = fit(config, dataset, folder, folder / CHECKPOINT if config.resume and resumable else None)
    summary = {
        "steps": result.steps,
        "seconds": round(time.monotonic() - started, 1),
        "training_seconds": round(result.training_seconds, 1),
        "peak_rss_mb": round(peak_rss_mb(), 1),
        "validation": result.validation,
        "class_iou": result.class_iou,
        "probe": result.probe.encoder,
        "probe_random_encoder": result.probe.random_encoder,
    }
    write_json(folder / SUMMARY, summary)
    figures = result.validation
    print(
        f"{folder}: {result.steps} steps, PSNR {figures['psnr_db']:.1f} dB, mIoU {figures['miou']:.2f}, "
        f"depth error {100 * figures['depth_mae_m']:.1f} cm"
    )
    print(result.probe.table())
