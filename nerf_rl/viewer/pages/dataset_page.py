"""``nerf-rl view DATASET``: serve its page, or save it."""

from numpy import ndarray

from nerf_rl.datasets.storage.reader import MultiViewDataset
from nerf_rl.datasets.storage.stored_manifest import LABELS
from nerf_rl.viewer.config import ViewConfig


def serve_dataset(config: ViewConfig, dataset: MultiViewDataset) -> None:
    """Serve until Ctrl-C."""
    from nerf_rl.viewer.pages.dataset_view import DatasetView
    from nerf_rl.viewer.server import serve, wait_for_interrupt, where_to_look

    with serve(config.host, config.port, dataset.manifest["scene"]["name"]) as server:
        page = DatasetView(server, dataset)
        print(where_to_look(config.host, server.get_port()), flush=True)
        page.gather_statistics()
        wait_for_interrupt()
        page.close()


def save_dataset(config: ViewConfig, dataset: MultiViewDataset) -> None:
    """Write the files asked for."""
    from nerf_rl.datasets.storage.frames import read_columns, read_frame
    from nerf_rl.viewer.drawing.charts import columns_chart, statistics_charts
    from nerf_rl.viewer.drawing.pictures import camera_strip, depth_limits
    from nerf_rl.viewer.drawing.slides import dataset_slides, evenly_chosen
    from nerf_rl.viewer.drawing.statistics import sample_statistics
    from nerf_rl.viewer.pages.saving import record_scene, save
    from nerf_rl.viewer.timeline import Timeline

    frames = evenly_chosen(len(dataset), config.frames)
    limits = depth_limits(read_frame(dataset, 0))
    timeline = Timeline(dataset)

    def charts() -> list[ndarray]:
        columns = read_columns(dataset, timeline.frames(timeline.first))
        found = statistics_charts(sample_statistics(dataset), dataset.palette)
        return found + ([columns_chart(columns)] if columns.columns else [])

    save(
        config.files,
        f"{dataset.manifest['scene']['name']}: dataset",
        dataset_slides(dataset, frames, lambda frame, view: camera_strip(frame, view, dataset.palette, limits)),
        None if LABELS in dataset.absent else (dataset.class_names, dataset.palette),
        charts,
        lambda: record_scene(dataset, frames[:12]),
    )
