"""``nerf-rl probe``: check the input, probe, print."""

from pathlib import Path

from nerf_rl.datasets.reader import MultiViewDataset
from nerf_rl.devices import check_device, resolve_device
from nerf_rl.pretrain.artefact import read_description
from nerf_rl.pretrain.config import ProbeConfig
from nerf_rl.pretrain.encoder_rig import EncoderRig
from nerf_rl.runs import SUMMARY, prepare_output, write_json, write_provenance


def probe(config: ProbeConfig) -> None:
    """Probe an encoder on a dataset's held-out episodes; print the table and write ``summary.json`` if asked to.

    Raises:
        UserError: no such encoder or dataset, no such device, or the dataset has another camera rig.
    """
    dataset = MultiViewDataset(config.data)
    _, description = read_description(config.encoder)
    EncoderRig.from_json(description["rig"]).require_same(EncoderRig.of_dataset(dataset))
    check_device(config.device)
    if config.out is not None:
        prepare_output(Path(config.out), config.overwrite)
        write_provenance(Path(config.out), "probe", config)

    from nerf_rl.pretrain.encoder import Encoder  # PyTorch takes seconds to import; mistakes are told before
    from nerf_rl.pretrain.linear_probe import probe_encoder

    encoder = Encoder.load(config.encoder).to(resolve_device(config.device))
    result = probe_encoder(encoder, dataset, config.frames, config.seed, config.ceiling_steps)
    print(result.table())
    if config.out is not None:
        write_json(Path(config.out) / SUMMARY, result.summary())
