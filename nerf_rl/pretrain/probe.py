"""``nerf-rl probe``: check the input, probe, print."""

from pathlib import Path

from nerf_rl.datasets.storage.reader import MultiViewDataset
from nerf_rl.datasets.storage.stored_manifest import STATE
from nerf_rl.errors import UserError
from nerf_rl.files.json_files import write_json
from nerf_rl.files.outputs import SUMMARY, check_output, prepare_output, require_outside, write_provenance
from nerf_rl.machine.devices import check_device, resolve_device
from nerf_rl.machine.threads import wait_passively
from nerf_rl.pretrain.config import ProbeConfig
from nerf_rl.pretrain.model.encoder_file import read_description
from nerf_rl.pretrain.model.encoder_rig import EncoderRig


def probe(config: ProbeConfig) -> None:
    """Probe an encoder on a dataset's held-out episodes; print the table and write ``summary.json`` if asked to.

    A dataset of another scene is taken, if its cameras are the encoder's own, and told.

    Raises:
        UserError: no such encoder or dataset, no such device, or the dataset has another camera rig or no true state.
    """
    dataset = MultiViewDataset(config.data)
    if STATE in dataset.absent:
        raise UserError(f"{config.data} has no columns of the true state, so there is nothing to read from a latent")
    _, description = read_description(config.encoder)
    EncoderRig.from_json(description["rig"]).require_same(EncoderRig.of_dataset(dataset))
    trained_on, shown = description["scene"]["name"], dataset.manifest["scene"]["name"]
    if trained_on != shown:  # what is meant where encoders are tried on other scenes, and a slip everywhere else
        print(f"{config.encoder} was trained on {trained_on}, and {config.data} shows {shown}")
    wait_passively()
    check_device(config.device)
    if config.out is not None:
        require_outside(Path(config.out), config.data, config.encoder)
        check_output(Path(config.out), config.overwrite)

    from nerf_rl.pretrain.measures.probing import probe_encoder
    from nerf_rl.pretrain.model.encoder import Encoder  # PyTorch takes seconds to import; mistakes are told before

    encoder = Encoder.load(config.encoder).to(resolve_device(config.device))
    result = probe_encoder(encoder, dataset, config.frames, config.seed, config.ceiling_steps)
    print(result.table())
    if config.out is not None:
        # only now, when there is something to put in the place of what was there
        prepare_output(Path(config.out), config.overwrite)
        write_provenance(Path(config.out), "probe", config)
        write_json(Path(config.out) / SUMMARY, result.summary())
