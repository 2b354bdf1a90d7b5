"""``nerf-rl view ENCODER``: find its dataset, then serve its page, or save it."""

from pathlib import Path, PurePath

import yaml

from nerf_rl.datasets.storage.reader import MultiViewDataset
from nerf_rl.datasets.storage.stored_manifest import LABELS
from nerf_rl.errors import MissingFileError, UserError
from nerf_rl.machine.devices import resolve_device
from nerf_rl.pretrain.model.encoder_file import described_classes, read_description
from nerf_rl.pretrain.model.encoder_rig import EncoderRig
from nerf_rl.scenes.imported import IMPORTED
from nerf_rl.viewer.config import ViewConfig


def dataset_of_encoder(config: ViewConfig) -> tuple[MultiViewDataset, Path]:
    """Return the dataset to look at through an encoder, and the encoder's run folder.

    Raises:
        UserError: no dataset is named, or it has other cameras, classes or another scene; the run holds no field.
    """
    folder, description = read_description(config.path)
    if not (folder / "field.json").is_file():
        remedy = "give the run folder that pretrain wrote"
        raise MissingFileError("an encoder with its radiance field", folder, "it holds no field.json", remedy)
    data = config.data or _recorded_dataset(folder)
    if not data or (not config.data and not Path(data).exists()):
        where = f"its dataset {data} is not there" if data else "its dataset is not known"
        raise UserError(f"{folder}: {where}; say where one with the same cameras is by --data FOLDER")
    dataset = MultiViewDataset(data)
    EncoderRig.from_json(description["rig"]).require_same(EncoderRig.of_dataset(dataset))
    _require_same_scene(folder, description["scene"]["name"], dataset)
    return dataset, folder


def _recorded_dataset(folder: Path) -> str:
    """Return the dataset that a run was trained on, as its configuration has it; empty if there is none."""
    path = folder / "config.yaml"
    if not path.is_file():
        return ""
    try:
        data = yaml.safe_load(path.read_text(encoding="utf-8"))["data"]
        if isinstance(data, str):
            return data
        reason: object = f"data is {data!r}"
    except (OSError, ValueError, LookupError, TypeError, RecursionError, yaml.YAMLError) as error:
        reason = error
    raise UserError(f"{path} does not say which dataset the encoder was trained on ({reason}); say by --data FOLDER")


def _require_same_scene(folder: Path, trained: str, dataset: MultiViewDataset) -> None:
    """Raise UserError unless a dataset shows the encoder's scene, and its labels, if it has any, mean the same."""
    shown, remedy = dataset.manifest["scene"]["name"], "say where a dataset of its own scene is by --data FOLDER"
    if not _may_be_the_same(trained, shown):
        raise UserError(
            f"the dataset {dataset.folder} is of scene {shown}, and the encoder {folder} was trained on {trained}; "
            f"{remedy}"
        )
    (known, _), labelled = described_classes(folder), list(dataset.class_names)
    if LABELS not in dataset.absent and labelled != known:
        raise UserError(
            f"the dataset {dataset.folder} has the classes {', '.join(labelled)}, and the encoder {folder} was trained "
            f"on {', '.join(known)}; {remedy} and with its classes"
        )


def _may_be_the_same(trained: str, shown: str) -> bool:
    """Tell whether two names may be those of one scene.

    The name of imported pictures tells one recording from another, not what they show. That of an MJCF file is a path,
    which is another one where the file has moved, and of which ``push`` keeps the last part alone.
    """
    if trained == shown or trained.startswith(IMPORTED) or shown.startswith(IMPORTED):
        return True
    from nerf_rl.scenes.make import MJCF_ENDINGS  # it takes MuJoCo's time to import

    return trained.endswith(MJCF_ENDINGS) and PurePath(trained).name == PurePath(shown).name


def serve_encoder(config: ViewConfig, dataset: MultiViewDataset, folder: Path) -> None:
    """Serve until Ctrl-C."""
    from nerf_rl.viewer.field.latents import EncodedDataset
    from nerf_rl.viewer.pages.dataset_view import DatasetView
    from nerf_rl.viewer.pages.encoder_view import EncoderPanel
    from nerf_rl.viewer.server import serve, wait_for_interrupt, where_to_look

    encoded = EncodedDataset(config.path, folder, dataset, resolve_device(config.device))
    with serve(config.host, config.port, f"{encoded.encoder.scene}: encoder") as server:
        page = DatasetView(server, dataset)
        panel = EncoderPanel(page, encoded)
        print(where_to_look(config.host, server.get_port()), flush=True)
        page.gather_statistics()
        wait_for_interrupt()
        panel.close()
        page.close()


def save_encoder(config: ViewConfig, dataset: MultiViewDataset, folder: Path) -> None:
    """Write the files asked for: each camera's truth, rendering and error."""
    from nerf_rl.datasets.storage.frames import Frame, read_frame
    from nerf_rl.viewer.drawing.charts import statistics_charts
    from nerf_rl.viewer.drawing.slides import dataset_slides, evenly_chosen
    from nerf_rl.viewer.drawing.statistics import sample_statistics
    from nerf_rl.viewer.field.latents import EncodedDataset
    from nerf_rl.viewer.field.reconstruction import comparison, render_views
    from nerf_rl.viewer.pages.saving import save

    encoded = EncodedDataset(config.path, folder, dataset, resolve_device(config.device))
    limits, far = encoded.depth_limits(read_frame(dataset, 0)), encoded.field.bounds.far

    def draw(frame: Frame, view: int):  # type: ignore[no-untyped-def]
        rendered = render_views(encoded.folded(encoded.latent(frame)), *frame.cameras([view]))
        assert rendered is not None  # nothing newer is ever wanted here
        return comparison(frame, view, rendered[0], dataset.palette, limits, far)

    save(
        config.files,
        f"{encoded.encoder.scene}: encoder",
        dataset_slides(dataset, evenly_chosen(len(dataset), config.frames), draw),
        None if LABELS in dataset.absent else (dataset.class_names, dataset.palette),
        lambda: statistics_charts(sample_statistics(dataset), dataset.palette),
    )
