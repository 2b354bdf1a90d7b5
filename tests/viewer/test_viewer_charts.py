"""What charts draw, read from their figures."""

import numpy as np
import pytest
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure

from nerf_rl.viewer.drawing import charts
from nerf_rl.viewer.drawing.charts import statistics_charts
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
