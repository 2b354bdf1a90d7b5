"""What the viewer shows of a dataset, checked against the dataset by other routes."""

import warnings
from pathlib import Path

import numpy as np
import pytest

from nerf_rl.cameras.geometry import project
from nerf_rl.datasets.storage.frames import EpisodeColumns, named_points, read_columns, read_frame
from nerf_rl.datasets.storage.point_cloud import fuse_views, unproject
from nerf_rl.datasets.storage.reader import MultiViewDataset
from nerf_rl.viewer.drawing.charts import columns_chart, statistics_charts
from nerf_rl.viewer.drawing.lines import as_lines
from nerf_rl.viewer.drawing.pictures import camera_strip, depth_limits, depth_scale, heat, legend
from nerf_rl.viewer.drawing.statistics import sample_statistics
from nerf_rl.viewer.pages.dataset_view import DatasetView
from nerf_rl.viewer.panels.columns_panel import ColumnsPanel
from nerf_rl.viewer.panels.scene_panel import ScenePanel
from nerf_rl.viewer.server import serve
from nerf_rl.viewer.timeline import Timeline


@pytest.fixture(scope="module")
def dataset(tiny_dataset: Path) -> MultiViewDataset:
    return MultiViewDataset(tiny_dataset)


def test_the_timeline_finds_every_episode_that_a_full_read_finds(dataset: MultiViewDataset) -> None:
    timeline, episodes = Timeline(dataset), dataset.read("episode")
    assert (timeline.first, timeline.last) == (episodes.min(), episodes.max())
    for episode in np.unique(episodes).tolist():
        assert list(timeline.frames(episode)) == np.flatnonzero(episodes == episode).tolist()
        assert timeline.episode(timeline.frames(episode).start) == episode
    with pytest.raises(IndexError, match="episodes are 0 to 3, got 4"):
        timeline.frames(4)


def test_a_point_of_the_cloud_projects_back_to_the_pixel_it_came_from(dataset: MultiViewDataset) -> None:
    frame = read_frame(dataset, 5)
    projections = dataset.projections([5])[0]
    for view in range(4):
        points = unproject(frame.depth[view], frame.intrinsics[view], frame.camera_from_world[view])
        pixels, depth = project(projections[view], points.reshape(-1, 3))
        rows, columns = np.mgrid[0:24, 0:24] + 0.5
        assert np.allclose(pixels[:, 0].reshape(24, 24), columns, atol=1e-3)
        assert np.allclose(pixels[:, 1].reshape(24, 24), rows, atol=1e-3)
        assert np.allclose(depth.reshape(24, 24), frame.depth[view], rtol=1e-5)


def test_clouds_of_different_cameras_agree_where_they_show_the_same_thing(dataset: MultiViewDataset) -> None:
    frame = read_frame(dataset, 5)
    drawer = [dataset.class_names.index(name) for name in dataset.class_names if name.startswith("drawer")]
    clouds = []
    for view in dataset.views("encoder"):
        points = unproject(frame.depth[view], frame.intrinsics[view], frame.camera_from_world[view])
        clouds.append(points[np.isin(frame.semantic[view], drawer)])
    # both see the cabinet's top: their highest points are equally high, within a coarse pixel
    assert abs(clouds[0][:, 2].max() - clouds[1][:, 2].max()) < 0.03


def test_the_cloud_keeps_the_chosen_classes_and_what_is_within_reach(dataset: MultiViewDataset) -> None:
    frame, limits = read_frame(dataset, 2), (0.2, 2.0)
    every = range(len(dataset.class_names))
    cloud = fuse_views(frame, "semantic", dataset.palette, limits, [1], 9.0)
    assert len(cloud.points) == ((frame.semantic == 1) & (frame.depth < 9.0)).sum() > 0
    assert (cloud.colours == dataset.palette[1]).all()
    assert len(fuse_views(frame, "RGB", dataset.palette, limits, every, 1.0).points) == (frame.depth < 1.0).sum()
    assert len(fuse_views(frame, "depth", dataset.palette, limits, every, 9.0, most=100).points) <= 100
    assert len(fuse_views(frame, "RGB", dataset.palette, limits, [], 9.0).points) == 0


def test_a_strip_shows_colours_labels_and_depth(dataset: MultiViewDataset) -> None:
    frame = read_frame(dataset, 0)
    strip = camera_strip(frame, 1, dataset.palette, depth_limits(frame), height=24)
    assert strip.shape == (24, 3 * 24 + 2 * 4, 3)
    assert np.array_equal(strip[:, :24], frame.rgb[1])
    assert np.array_equal(strip[:, 28:52], dataset.palette[frame.semantic[1]])


def test_the_legend_names_every_class_with_its_colour(dataset: MultiViewDataset) -> None:
    shown = legend(dataset.class_names, dataset.palette)
    for name, colour in zip(dataset.class_names, dataset.palette.tolist(), strict=True):
        assert f"rgb{tuple(colour)}" in shown and f"{name}</span>" in shown


def test_the_depth_scale_begins_near_and_ends_far() -> None:
    scale = depth_scale((0.5, 1.5), width=300)
    assert scale[5, 0].astype(int).sum() > scale[5, -1].astype(int).sum()  # what is far is dark
    assert (scale[20:] < 200).any()


def test_an_error_is_black_where_there_is_none_and_brightest_at_the_limit() -> None:
    shown = heat(np.array([[0.0, 0.5, 1.0, 7.0]]), 1.0).astype(int).sum(-1)[0]
    assert shown[0] < 15 and shown[0] < shown[1] < shown[2] == shown[3]


def test_positions_are_gathered_from_columns_that_have_all_three_axes() -> None:
    points = named_points(("hand_x", "hand_y", "hand_z", "lid_x", "gripper"), np.arange(5.0))
    assert points == {"hand": (0.0, 1.0, 2.0)}


def test_statistics_are_those_of_the_first_frames(dataset: MultiViewDataset) -> None:
    episodes = dataset.read("episode")
    first = [int(np.flatnonzero(episodes == e)[0]) for e in np.unique(episodes)]
    statistics = sample_statistics(dataset)
    labels = dataset.read("semantic", first)
    for i, name in enumerate(dataset.class_names):
        assert np.isclose(statistics.class_shares[name], (labels == i).mean())
    column = dataset.columns("privileged").index("handle_x")
    assert np.allclose(statistics.places["handle"][:, 0], dataset.read("state/privileged", first)[:, column])
    assert len(sample_statistics(dataset, episodes=2).places["hand"]) == 2


def test_charts_are_not_blank(dataset: MultiViewDataset) -> None:
    columns = read_columns(dataset, range(3))
    assert np.array_equal(columns.columns["reward"], dataset.read("reward", [0, 1, 2]))
    charts = statistics_charts(sample_statistics(dataset), dataset.palette)
    assert len(charts) == 2  # where things are, shares of classes
    for chart in (*charts, columns_chart(columns)):
        assert chart.ndim == 3 and chart.std() > 10


def test_a_dataset_without_a_state_has_a_chart_of_what_there_is() -> None:
    columns = EpisodeColumns(np.arange(3.0), {"reward": np.array([0.0, 1.0, 0.5])})
    with warnings.catch_warnings(action="error"):  # as of a legend without names
        chart = columns_chart(columns).astype(int)
    is_line = np.abs(chart - (31, 119, 180)).max(-1) < 8  # Matplotlib's first colour
    left, right = np.array_split(is_line, 2, axis=1)
    assert left.sum() > 100 and right.sum() > 100


def test_lines_go_on_after_a_reset_within_an_episode_with_a_gap() -> None:
    steps, (line,) = as_lines(np.array([23.0, 28.0, 8.0, 9.0, 0.0]), [np.arange(5.0)])
    assert steps.tolist() == [23, 28, 36.5, 37, 38, 38.5, 39]  # ascending, the resets one step after the frames before
    assert np.array_equal(line, [0, 1, np.nan, 2, 3, np.nan, 4], equal_nan=True)
    unbroken, (line,) = as_lines(np.array([0.0, 3.0]), [np.arange(2.0)])
    assert unbroken.tolist() == [0, 3] and line.tolist() == [0, 1]


def test_the_episodes_plot_ascends_and_marks_one_frame() -> None:
    columns = EpisodeColumns(np.array([8.0, 28.0, 8.0]), {"hand_x": np.array([1.0, 2.0, 3.0])})
    with serve("127.0.0.1", 0, "test") as server:
        panel = ColumnsPanel(server.gui, list(columns.columns))
        panel.show(columns, 2)
        steps, _, now = panel._plot.data
    assert (np.diff(steps) > 0).all()
    assert now[~np.isnan(now)].tolist() == [3.0]


def test_positions_have_the_colours_of_the_axes() -> None:
    with serve("127.0.0.1", 0, "test") as server:
        panel = ColumnsPanel(server.gui, [f"hand_{axis}" for axis in "xyz"])
        panel.show(EpisodeColumns(np.arange(2.0), {f"hand_{axis}": np.zeros(2) for axis in "xyz"}), 0)
        strokes = [line["stroke"] for line in panel._plot.series[1:4]]
    channels = [[int(stroke[i : i + 2], 16) for i in (1, 3, 5)] for stroke in strokes]
    assert np.argmax(channels, axis=1).tolist() == [0, 1, 2]


def test_cameras_are_hidden_with_their_names(dataset: MultiViewDataset) -> None:
    with serve("127.0.0.1", 0, "test") as server:
        frame = read_frame(dataset, 0)
        panel = ScenePanel(server, dataset, frame, lambda: None)
        panel.show(frame)
        for shown in (False, True):
            panel._show_frusta(shown)
            assert {node.visible for node in (*panel._frusta, *panel._names)} == {shown}


def test_a_page_tells_of_success_only_where_there_is_one(dataset: MultiViewDataset) -> None:
    """A scene that tells nothing of it has no frame with one either."""
    with serve("127.0.0.1", 0, "test") as server:
        page = DatasetView(server, dataset)
        page.close()
        page._show(int(np.argmin(dataset.read("success"))), lambda: False)
        assert "step" in page.status.content and "success" not in page.status.content
