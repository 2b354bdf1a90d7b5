"""State, actions and reward along the episode, with the present marked."""

import numpy as np
import viser
import viser.uplot

from nerf_rl.datasets.storage.frames import EpisodeColumns
from nerf_rl.viewer.drawing.lines import as_lines, plotted_together

# the first three as the axes in the 3-D scene are: x red, y green, z blue
_COLOURS = ("#d62728", "#2ca02c", "#1f77b4", "#9467bd", "#ff7f0e", "#17becf", "#8c564b", "#e377c2", "#7f7f7f")


class ColumnsPanel:
    """Plots chosen columns over the steps of an episode.

    Args:
        gui: where to put it; the current container is used.
        names: of the columns, group by group.
    """

    def __init__(self, gui: viser.GuiApi, names: list[str]):
        self._groups = plotted_together(names)
        first = next(iter(self._groups))
        self.group = gui.add_dropdown("Plot", tuple(self._groups), initial_value=first)
        self._columns: EpisodeColumns | None = None
        self._place = 0
        empty = (np.array([0.0, 1.0]), np.array([0.0, 0.0]), np.array([0.0, 0.0]))
        self._plot = gui.add_uplot(empty, _series(["-"]), height=190, scales={"x": {"time": False}})
        self.group.on_update(lambda _: self._draw())

    def show(self, columns: EpisodeColumns, place: int) -> None:
        """Draw an episode and mark a place in it, counted in frames from its first one."""
        self._columns, self._place = columns, place
        self._draw()

    def _draw(self) -> None:
        if self._columns is None:
            return
        names = self._groups[self.group.value]
        values = [self._columns.columns[name] for name in names]
        now = np.where(np.arange(len(values[0])) == self._place, values[0], np.nan)
        steps, lines = as_lines(self._columns.steps, [*values, now])
        self._plot.series = _series(names)
        self._plot.data = (steps, *lines)


def _series(names: list[str]) -> tuple[viser.uplot.Series, ...]:
    lines = [
        viser.uplot.Series(label=name, stroke=_COLOURS[i % len(_COLOURS)], width=2) for i, name in enumerate(names)
    ]
    present = viser.uplot.Series(label="now", stroke="#111", points={"show": True, "size": 9}, width=0)
    return (viser.uplot.Series(label="step"), *lines, present)
