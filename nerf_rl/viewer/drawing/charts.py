"""Charts as pictures, drawn by Matplotlib."""

import itertools
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float, UInt8
from numpy import ndarray

from nerf_rl.datasets.storage.frames import EpisodeColumns
from nerf_rl.viewer.drawing.lines import as_lines, plotted_together
from nerf_rl.viewer.drawing.statistics import Statistics

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_MOST_TOLD_APART = 10  # lines or dots, by Matplotlib's colours
_MARKERS = "x+1^sv"  # of so many each
_SHORT_NAME = 14  # characters of which three stand in a row of a chart's legend


def statistics_charts(statistics: Statistics, palette: UInt8[ndarray, "C 3"]) -> list[UInt8[ndarray, "_ _ 3"]]:
    """Return where things are, and the share of each class in the pixels; of these what is known."""
    colours = dict(zip(statistics.class_shares, palette / 255.0, strict=False))  # without labels there are no shares
    charts = [_places_chart(statistics.places, colours)] if statistics.places else []
    return charts + ([_shares_chart(statistics.class_shares, colours)] if colours else [])


def columns_chart(columns: EpisodeColumns) -> UInt8[ndarray, "A B 3"]:
    """Return the columns along an episode, of which there is one at least, a panel for each thing."""
    groups = plotted_together(list(columns.columns))
    across = min(2, len(groups))
    down = -(-len(groups) // across)
    figure = _figure(7.0, 1.4 * down + 0.4)
    panels = figure.subplots(down, across, sharex=True, squeeze=False).ravel()
    for axes, (group, names) in zip(panels, groups.items(), strict=False):
        steps, lines = as_lines(columns.steps, [columns.columns[name] for name in names])
        for name, values in zip(names, lines, strict=True):
            axes.plot(steps, values, marker=".", label=_literal(name))
        axes.set_title(_literal(group if len(names) > 1 else names[0]), fontsize=8)
        axes.tick_params(labelsize=7)
        if 1 < len(names) <= _MOST_TOLD_APART:
            axes.legend(fontsize=6)
    for axes in panels[len(groups) :]:
        axes.remove()
    for axes in panels[len(groups) - across : len(groups)]:
        axes.set_xlabel("environment step", fontsize=8)
        axes.xaxis.set_tick_params(labelbottom=True)  # of the last but one, too, where nothing is below it
    return rasterise(figure)


def lines_chart(
    lines: dict[str, Float[ndarray, "N"]], xlabel: str, x: ndarray | None = None
) -> UInt8[ndarray, "A B 3"]:
    """Return lines over 0, 1, 2, ... or ``x``, one panel each, below one another."""
    figure = _figure(4.4, 1.3 * len(lines) + 0.4)
    panels = np.atleast_1d(figure.subplots(len(lines), 1, sharex=True))
    for axes, (name, values) in zip(panels, lines.items(), strict=True):
        axes.plot(np.arange(len(values)) if x is None else x, values)
        axes.set_ylabel(_literal(name), fontsize=8)
        axes.tick_params(labelsize=7)
    panels[-1].set_xlabel(xlabel, fontsize=8)
    return rasterise(figure)


def rasterise(figure: "Figure") -> UInt8[ndarray, "A B 3"]:
    """Return a figure's pixels."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg

    canvas = FigureCanvasAgg(figure)
    canvas.draw()
    return np.asarray(canvas.buffer_rgba())[..., :3].copy()


def _literal(name: str) -> str:
    """Return a name such that Matplotlib draws it as it is: dollars begin no formula, an underscore hides no label."""
    escaped = name.replace("$", r"\$")
    return f" {escaped}" if escaped.startswith("_") else escaped


def _places_chart(places: dict[str, Float[ndarray, "_ 2"]], colours: dict[str, ndarray]) -> UInt8[ndarray, "A B 3"]:
    """A thing that is a class is a dot of its colour, others are crosses."""
    columns = 3 if max(map(len, places)) <= _SHORT_NAME else 2
    figure = _figure(4.4, 3.4 + 0.18 * -(-len(places) // columns))
    axes = figure.subplots()
    others = (marker for marker in itertools.cycle(_MARKERS) for _ in range(_MOST_TOLD_APART))
    for name, xy in places.items():
        marker = "o" if name in colours else next(others)
        axes.scatter(xy[:, 0], xy[:, 1], s=12, alpha=0.6, label=_literal(name), color=colours.get(name), marker=marker)
    title = "where things are (first kept frame of each episode)"
    axes.set(xlabel="x [m]", ylabel="y [m]", aspect="equal", adjustable="datalim")
    axes.set_title(title, fontsize=9)
    figure.legend(loc="outside lower center", ncols=columns, fontsize=8)
    return rasterise(figure)


def _shares_chart(shares: dict[str, float], colours: dict[str, ndarray]) -> UInt8[ndarray, "A B 3"]:
    figure = _figure(4.4, max(2.2, 0.2 * len(shares) + 0.6))
    axes = figure.subplots()
    names = list(shares)[::-1]
    percent = [100 * shares[name] for name in names]
    bars = axes.barh([_literal(name) for name in names], percent, color=[colours[name] for name in names])
    axes.bar_label(bars, fmt="%.1f", padding=3, fontsize=8)
    axes.set(xlabel="share of pixels [%]")
    axes.margins(x=0.15)
    return rasterise(figure)


def _figure(width: float, height: float) -> "Figure":
    from matplotlib.figure import Figure  # takes half a second to import

    return Figure(figsize=(width, height), dpi=100, layout="constrained")
