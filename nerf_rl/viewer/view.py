"""``nerf-rl view``: find out what the path is and show it."""

from pathlib import Path

import yaml

from nerf_rl.datasets.reader import MultiViewDataset
from nerf_rl.errors import MissingFileError, OutputExistsError, UserError
from nerf_rl.pretrain.artefact import read_description
from nerf_rl.pretrain.encoder_rig import EncoderRig
from nerf_rl.rl.artefact import check_policy
from nerf_rl.threads import yield_while_waiting
from nerf_rl.viewer.config import ViewConfig
from nerf_rl.viewer.subject import Subject, find_subject


def view(config: ViewConfig) -> None:
    """Serve a page until Ctrl-C, or write the files that were asked for.

    Raises:
        UserError: nothing there to view, a file exists, the port is taken.
    """
    subject = find_subject(Path(config.path))
    for path in config.files.values():
        if path.exists() and not config.overwrite:
            raise OutputExistsError(path, "use --overwrite true or another name")
    if subject is Subject.DATASET:
        _view_dataset(config)
    elif subject is Subject.ENCODER:
        _view_encoder(config)
    else:
        _view_agent(config)


def _view_dataset(config: ViewConfig) -> None:
    dataset = MultiViewDataset(config.path)
    from nerf_rl.viewer.dataset_view import DatasetView
    from nerf_rl.viewer.server import serve, wait_for_interrupt, where_to_look

    with serve(config.host, config.port, dataset.manifest["scene"]["name"]) as server:
        page = DatasetView(server, dataset)
        print(where_to_look(config.host, server.get_port()), flush=True)
        page.gather_statistics()
        wait_for_interrupt()
        page.close()


def _view_encoder(config: ViewConfig) -> None:
    dataset, folder = _dataset_of_encoder(config)
    yield_while_waiting()
    import torch

    torch.set_num_threads(config.threads)
    from nerf_rl.viewer.dataset_view import DatasetView
    from nerf_rl.viewer.encoder_view import EncoderPanel
    from nerf_rl.viewer.latents import EncodedDataset
    from nerf_rl.viewer.server import serve, wait_for_interrupt, where_to_look

    encoded = EncodedDataset(config.path, folder, dataset)
    with serve(config.host, config.port, f"{encoded.encoder.scene}: encoder") as server:
        page = DatasetView(server, dataset)
        panel = EncoderPanel(page, encoded)
        print(where_to_look(config.host, server.get_port()), flush=True)
        page.gather_statistics()
        wait_for_interrupt()
        panel.close()
        page.close()


def _dataset_of_encoder(config: ViewConfig) -> tuple[MultiViewDataset, Path]:
    """Return the dataset to look at through an encoder, and the encoder's run folder.

    Raises:
        UserError: no dataset is named, or it has other cameras; the run holds no field.
    """
    folder, description = read_description(config.path)
    if not (folder / "field.json").is_file():
        remedy = "give the run folder that pretrain wrote"
        raise MissingFileError("an encoder with its radiance field", folder, "it holds no field.json", remedy)
    data = config.data
    if not data and (folder / "config.yaml").is_file():
        data = yaml.safe_load((folder / "config.yaml").read_text(encoding="utf-8")).get("data", "")
    if not data or (not config.data and not Path(data).exists()):
        where = f"its dataset {data} is not there" if data else "its dataset is not known"
        raise UserError(f"{folder}: {where}; say where one with the same cameras is by --data FOLDER")
    dataset = MultiViewDataset(data)
    EncoderRig.from_json(description["rig"]).require_same(EncoderRig.of_dataset(dataset))
    return dataset, folder


def _view_agent(config: ViewConfig) -> None:
    check_policy(Path(config.path), config.encoder)
    yield_while_waiting()
    import torch

    torch.set_num_threads(config.threads)
    from nerf_rl.viewer.agent import Agent
    from nerf_rl.viewer.agent_view import AgentView
    from nerf_rl.viewer.server import serve, wait_for_interrupt, where_to_look

    agent = Agent(Path(config.path), config.encoder, config.seed, config.episodes)
    with serve(config.host, config.port, f"{agent.policy.spec.scene}: agent") as server:
        page = AgentView(server, agent)
        print(where_to_look(config.host, server.get_port()), flush=True)
        wait_for_interrupt()
        page.close()
