"""Charts in print: matplotlib, one style, readable without colour."""

import math
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import matplotlib
import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, LogLocator, NullLocator

from riecjax.charts import (
    PLAIN,
    Axis,
    Chart,
    Dots,
    HeatMap,
    Level,
    Line,
    Mark,
    Panel,
    Span,
)
from riecjax.errors import DataError
from riecjax.whole_files import stamp

DOTS_PER_INCH = 150
DECADE = 12
"""Ratio of an axis' ends up to which 1, 2, 5 would be too few numbers on it."""
LETTER, HANDLE = 0.062, 0.42
"""Inches that a letter and a sign with its gaps take in a legend."""
BAND = 0.18
"""Opacity of a band about a line."""
LINE = 15.0
"""Points that a row of a legend takes."""
STYLE: Any = {
    "font.size": 9,
    "axes.titlesize": 9,
    "axes.titleweight": "bold",
    "axes.titlelocation": "left",
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "axes.axisbelow": True,
    "grid.color": "#ececec",
    "legend.fontsize": "small",
    "legend.frameon": False,
    "legend.borderpad": 0.1,
    "legend.borderaxespad": 0.2,
    "legend.columnspacing": 1.2,
    "figure.constrained_layout.use": True,
    # A name with two dollars in it is no formula.
    "text.parse_math": False,
}


def print_chart(chart: Chart, file: Path) -> None:
    """Write the chart as a PNG file."""
    # Numbers on axes are made as late as here, and look the style up then.
    with matplotlib.rc_context(STYLE):
        printed(chart).savefig(file, dpi=DOTS_PER_INCH, metadata={"Comment": stamp(file)})


def printed(chart: Chart) -> Figure:
    """The chart as a matplotlib figure, to be drawn in `STYLE`."""
    with matplotlib.rc_context(STYLE):
        figure = Figure(figsize=chart.size)
        FigureCanvasAgg(figure)
        _fill(figure, chart)
    return figure


def drawn(chart: Chart, ax: Any = None) -> Any:
    """The chart in a new figure of pyplot's, or in the axes given, as many as it has panels.

    **Returns:** the axes of one panel, the figure of several.

    **Raises:** `DataError` for another number of axes.
    """
    if ax is None:
        from matplotlib import pyplot

        # Outside the style: pyplot may only now choose its backend, whose settings are to stay.
        figure = pyplot.figure(figsize=chart.size, layout="constrained")
        with matplotlib.rc_context(STYLE):
            _fill(figure, chart)
        return figure if len(chart.panels) > 1 else figure.axes[0]
    every = np.ravel(np.asarray(ax, dtype=object))
    if len(every) != len(chart.panels):
        raise DataError(
            f"ax must be as many axes as there are panels, {len(chart.panels)}; got {len(every)}. "
            f"Leave it out for a figure of its own."
        )
    for axes, panel in zip(every, chart.panels):
        _draw_panel(axes, panel, replace(chart, legend=False))
    return every[0].get_figure() if len(every) > 1 else every[0]


def _fill(figure: Figure, chart: Chart) -> None:
    grid = figure.add_gridspec(len(chart.rows), chart.columns)
    above: dict[int, Any] = {}
    left: dict[int, Any] = {}
    for row, place, panel in chart.places:
        axes = figure.add_subplot(
            grid[row, place : place + panel.columns],
            sharex=above.get(place) if chart.share_x else None,
            sharey=left.get(row) if chart.share_y else None,
        )
        above[place] = left[row] = axes
        _draw_panel(axes, panel, chart)


def _draw_panel(axes: Any, panel: Panel, chart: Chart) -> None:
    scales = ["log" if axis.log else "linear" for axis in (panel.x, panel.y)]
    axes.set(xscale=scales[0], yscale=scales[1])
    for mark in panel.marks:
        _draw(axes, mark)
    _finish(axes.xaxis, panel.x, axes.set_xlim)
    _finish(axes.yaxis, panel.y, axes.set_ylim)
    handles, labels = axes.get_legend_handles_labels()
    axes.tick_params(
        labelbottom=bool(panel.x.label) or not chart.share_x,
        labelleft=bool(panel.y.label) or not chart.share_y,
    )
    # Title and legend, above the panel; the legend of the first one perhaps above all.
    rows = 0
    if chart.legend:
        figure = axes.get_figure()
        if labels and not figure.legends:
            columns = _columns(labels, chart.size[0])
            figure.legend(handles, labels, loc="outside upper center", ncols=columns)
    elif labels:
        columns = _columns(labels, chart.size[0] * panel.columns / chart.columns - 0.8)
        rows = -(-len(labels) // columns)
        place: Any = {"loc": "lower left", "bbox_to_anchor": (0, 1)}
        axes.legend(handles, labels, **place, ncols=columns, handlelength=1.6)
    axes.set_title(panel.title, pad=4 + LINE * rows)


def _columns(labels: Sequence[str], inches: float) -> int:
    """How many entries of a legend stand beside each other."""
    for columns in range(len(labels), 1, -1):
        longest = [max(map(len, labels[i::columns])) for i in range(columns)]
        if sum(LETTER * length + HANDLE for length in longest) <= inches:
            return columns
    return 1


def _draw(axes: Any, mark: Mark) -> None:
    match mark:
        case Line():
            if mark.low is not None and mark.high is not None:
                band = {"color": mark.color, "alpha": BAND, "linewidth": 0}
                axes.fill_between(mark.x, mark.low, mark.high, **band)
            look = {"color": mark.color, "linestyle": mark.dashes, "linewidth": mark.width}
            look |= {"marker": "o" if mark.markers else None, "markersize": 3, "label": mark.label}
            if mark.error is None:
                axes.plot(mark.x, mark.y, **look)
            else:
                axes.errorbar(mark.x, mark.y, mark.error, capsize=2, **look)
        case Dots():
            look = {"color": mark.color, "alpha": mark.opacity, "label": mark.label}
            axes.plot(mark.x, mark.y, "o", markersize=mark.size, markeredgewidth=0, **look)
        case Span():
            across = axes.axvspan if mark.axis == "x" else axes.axhspan
            look = {"color": mark.color, "alpha": mark.opacity, "label": mark.label}
            across(mark.low, mark.high, linewidth=0, zorder=0.5, **look)
        case Level():
            across = axes.axvline if mark.axis == "x" else axes.axhline
            look = {"color": mark.color, "linestyle": mark.dashes, "label": mark.label}
            across(mark.value, linewidth=0.9, zorder=1.5, **look)
        case HeatMap():
            values, x, y = np.asarray(mark.values), np.asarray(mark.x), np.asarray(mark.y)
            axes.grid(False)
            look = {"cmap": "RdBu_r", "shading": "nearest", "vmin": mark.low, "vmax": mark.high}
            image = axes.pcolormesh(x, y, np.ma.masked_invalid(values), **look)
            bar = axes.get_figure().colorbar(image, ax=axes, label=mark.label)
            bar.outline.set_visible(False)
            bar.ax.grid(False)
            numbered = np.argwhere(np.isfinite(values)) if mark.numbers is not None else ()
            for row, column in numbered:
                value = values[row, column]
                # Luma (ITU-R BT.601, rounded): numbers on dark cells are white.
                dark = np.dot(image.cmap(image.norm(value))[:3], (0.3, 0.6, 0.1)) < 0.5
                style = {"fontsize": "x-small", "color": "white" if dark else "black"}
                text = f"{value:.{mark.numbers}f}"
                axes.text(x[column], y[row], text, ha="center", va="center", **style)


def _finish(axis: Any, wanted: Axis, set_limits: Any) -> None:
    axis.set_label_text(wanted.label)
    if wanted.categories:
        axis.set_ticks(range(len(wanted.categories)), wanted.categories)
        axis.grid(False)
        if axis.axis_name == "x" and max(map(len, wanted.categories)) > 3:
            for label in axis.get_ticklabels():
                label.set(rotation=45, ha="right", rotation_mode="anchor")
    if wanted.low is not None or wanted.high is not None:
        set_limits(wanted.low, wanted.high)
    if wanted.log:
        # Numbers as 1, 2, 5, 10 where they are of a readable size, else as 1e-5, 1e-4: Matplotlib's
        # own are mathematical text, which names of signals must not be taken for.
        low, high = sorted(axis.get_view_interval())
        axis.set_minor_locator(NullLocator())
        axis.set_major_formatter(FuncFormatter(lambda value, _: f"1e{math.log10(value):.0f}"))
        if low >= PLAIN[0] and high <= PLAIN[1]:
            few, many = high < DECADE * low, high > 1e3 * low
            subs = (1, 1.5, 2, 3, 4, 5, 6, 8) if few else (1,) if many else (1, 2, 5)
            axis.set_major_locator(LogLocator(subs=subs))
            axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    if wanted.reverse:
        axis.set_inverted(True)
