"""``nerf-rl view``: find out what the path is, and show or save it."""

import dataclasses
from pathlib import Path

from nerf_rl.datasets.storage.reader import MultiViewDataset
from nerf_rl.errors import OutputExistsError
from nerf_rl.files.outputs import require_file_place
from nerf_rl.hub.fetch import resolve
from nerf_rl.machine.devices import check_device
from nerf_rl.machine.threads import wait_passively
from nerf_rl.rl.agents.policy_file import check_policy, find_run
from nerf_rl.viewer.config import ViewConfig
from nerf_rl.viewer.pages.agent_page import save_agent, serve_agent
from nerf_rl.viewer.pages.dataset_page import save_dataset, serve_dataset
from nerf_rl.viewer.pages.encoder_page import dataset_of_encoder, save_encoder, serve_encoder
from nerf_rl.viewer.subject import Subject, find_subject


def view(config: ViewConfig) -> None:
    """Serve a page until Ctrl-C, or write the files that were asked for.

    Raises:
        UserError: nothing there to view, a file exists, the port is taken, no such device.
    """
    folder = resolve(config.path)
    subject = find_subject(folder)
    if subject is Subject.AGENT:
        folder = find_run(config.path)  # which refuses what somebody else's agent must not do
    if subject is not Subject.ENCODER and folder.is_file():  # of an encoder, a file may be the one to look at
        folder = folder.parent
    config = dataclasses.replace(config, path=str(folder))
    check_device(config.device)
    for path in config.files.values():
        if path.exists() and not config.overwrite:
            raise OutputExistsError(path, "use --overwrite true or another name")
        require_file_place(path)
    if subject is Subject.DATASET:
        (save_dataset if config.files else serve_dataset)(config, _open(config.path))
    elif subject is Subject.ENCODER:
        dataset, folder = dataset_of_encoder(config)
        _prepare_torch(config.threads)
        (save_encoder if config.files else serve_encoder)(config, dataset, folder)
    else:
        check_policy(Path(config.path), config.encoder)
        _prepare_torch(config.threads)
        (save_agent if config.files else serve_agent)(config)


def _open(path: str) -> MultiViewDataset:
    """Open a dataset, or what there is so far of one that is being written."""
    dataset = MultiViewDataset(path, unfinished=True)
    if not dataset.is_finished:
        print(f"{path} is not finished: this is what its {len(dataset.manifest['shards'])} whole shards hold")
    return dataset


def _prepare_torch(threads: int) -> None:
    wait_passively()
    import torch  # takes seconds; mistakes are told before

    torch.set_num_threads(threads)
