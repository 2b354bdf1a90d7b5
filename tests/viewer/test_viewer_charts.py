"""What charts draw, read from their figures."""

import itertools
import warnings

import numpy as np
import pytest
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure

from nerf_rl.datasets.storage.frames import EpisodeColumns
from nerf_rl.viewer.drawing import charts
from nerf_rl.viewer.drawing.charts import columns_chart, statistics_charts
from nerf_rl.viewer.drawing.statistics import Statistics


@pytest.fixture
def figures(monkeypatch: pytest.MonkeyPatch) -> list[Figure]:
    """The figures drawn since."""
    made: list[Figure] = []
    begin = charts._figure

    def record(width: float, height: float) -> Figure:
        made.append(begin(width, height))
        return made[-1]

    monkeypatch.setattr(charts, "_figure", record)
    return made


def test_a_thing_that_is_a_class_has_its_colour_and_others_another_marker(figures: list[Figure]) -> None:
    palette = np.array([[90, 90, 90], [242, 60, 10], [10, 60, 242]], np.uint8)
    places = {name: np.array([[0.0, 1.0], [1.0, 2.0]]) for name in ("hand", "blue", "red")}
    statistics_charts(Statistics(places, {"background": 0.5, "red": 0.2, "blue": 0.3}), palette)
    hand, blue, red = figures[0].axes[0].collections
    bars = figures[1].axes[0].patches  # from below: the classes from the last one
    for dots, bar, colour in ((blue, bars[0], palette[2]), (red, bars[1], palette[1])):
        assert np.allclose(dots.get_facecolor()[0, :3], colour / 255)
        assert np.allclose(to_rgb(bar.get_facecolor()), colour / 255)
    assert len(hand.get_paths()[0].vertices) != len(red.get_paths()[0].vertices)


def test_a_chart_of_places_says_which_frames_they_are_of(figures: list[Figure]) -> None:
    """Datasets keep random steps: the first one that is kept of an episode is seldom its reset."""
    statistics_charts(Statistics({"hand": np.zeros((1, 2))}, {}), np.zeros((1, 3), np.uint8))
    assert "first kept frame" in figures[0].axes[0].get_title()


def test_charts_of_many_things_have_room_for_all(figures: list[Figure]) -> None:
    names = [f"class_{i}" for i in range(45)]
    statistics = Statistics({f"body_{i}": np.eye(2) for i in range(45)}, dict.fromkeys(names, 1 / 45))
    with warnings.catch_warnings(action="error"):  # as of a layout for which there is no room
        statistics_charts(statistics, np.tile(np.arange(45, dtype=np.uint8)[:, None], 3))
    scatter, bars = figures
    labels = [label.get_window_extent() for label in bars.axes[0].get_yticklabels()]
    assert all(above.y0 >= below.y1 for below, above in itertools.pairwise(labels))
    assert scatter.legends[0].get_window_extent().y1 <= scatter.axes[0].get_window_extent().y0
    dots = scatter.axes[0].collections
    looks = {(tuple(each.get_edgecolor()[0]), each.get_paths()[0].vertices.tobytes()) for each in dots}
    assert len(looks) == 45


def test_columns_have_a_panel_for_each_thing_that_names_it(figures: list[Figure]) -> None:
    state = {f"body_{i}_{axis}": np.arange(3.0) for i in range(20) for axis in "xyz"}
    acted = {f"action_{i}": np.arange(3.0) for i in range(17)}
    chart = columns_chart(EpisodeColumns(np.arange(3.0), state | acted | {"elbow_velocity": np.arange(3.0)}))
    panels = figures[0].axes
    assert [axes.get_title() for axes in panels] == [*(f"body_{i}" for i in range(20)), "action", "elbow_velocity"]
    assert [len(axes.lines) for axes in panels] == [3] * 20 + [17, 1]
    assert [axes.get_legend() is not None for axes in panels] == [True] * 20 + [False, False]
    assert len(chart) > 1000
