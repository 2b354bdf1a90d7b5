"""``nerf-rl view``: find out what the path is and show it."""

from pathlib import Path

from nerf_rl.datasets.reader import MultiViewDataset
from nerf_rl.errors import OutputExistsError
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
