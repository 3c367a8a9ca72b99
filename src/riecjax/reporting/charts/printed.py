"""Charts in print: matplotlib, one style, readable without colour."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from riecjax.reporting.charts.chart import (
    Axis,
    Chart,
    Dots,
    HeatMap,
    Level,
    Line,
    Mark,
    Panel,
    Span,
    Stems,
    as_array,
)
from riecjax.reporting.output import require_plots

DECADE = 12
"""Ratio of an axis' ends up to which 1, 2, 5 would be too few numbers on it."""
PLAIN = (1e-3, 1e5)
"""Numbers on a logarithmic axis between these are written out, others as powers of ten."""
STYLE = {
    "font.size": 9,
    "axes.titlesize": "medium",
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "axes.axisbelow": True,
    "grid.color": "#ececec",
    "legend.fontsize": "small",
    "legend.framealpha": 0.9,
    "legend.edgecolor": "none",
    "figure.constrained_layout.use": True,
}


def printed(chart: Chart) -> Any:
    """The chart as a matplotlib figure.

    **Raises:** `DataError` if matplotlib is not installed.
    """
    plt = require_plots()
    with plt.rc_context(STYLE):
        figure = plt.figure(figsize=chart.size)
        grid = figure.add_gridspec(
            len(chart.rows), chart.columns, height_ratios=chart.heights or None
        )
        drawn: list[tuple[Panel, Any]] = []
        above: dict[int, Any] = {}
        for i, row in enumerate(chart.rows):
            place, left = 0, None
            for panel in row:
                if panel is None:
                    place += 1
                    continue
                axes = figure.add_subplot(
                    grid[i, place : place + panel.columns],
                    sharex=above.get(place) if chart.share_x else None,
                    sharey=left if chart.share_y else None,
                )
                _draw_panel(axes, panel)
                drawn.append((panel, axes))
                above[place], left = axes, axes
                place += panel.columns
        _legends(figure, chart, drawn)
    return figure


def _draw_panel(axes: Any, panel: Panel) -> None:
    right = None
    if panel.right is not None:
        right = axes.twinx()
        right.grid(False)
    _scale(axes.xaxis, panel.x)
    _scale(axes.yaxis, panel.y)
    for mark in panel.marks:
        on_right = isinstance(mark, Line) and mark.right
        _draw(right if on_right and right is not None else axes, mark)
    _finish(axes.xaxis, panel.x, axes.set_xlim)
    _finish(axes.yaxis, panel.y, axes.set_ylim)
    if right is not None and panel.right is not None:
        _scale(right.yaxis, panel.right)
        _finish(right.yaxis, panel.right, right.set_ylim)
        right.spines["right"].set_visible(True)
    axes.set_title(panel.title)


def _draw(axes: Any, mark: Mark) -> None:
    match mark:
        case Line():
            _draw_line(axes, mark)
        case Dots():
            axes.plot(
                as_array(mark.x),
                as_array(mark.y),
                "o",
                color=mark.color,
                markersize=mark.size,
                markeredgewidth=0,
                alpha=mark.opacity,
                label=mark.label,
                rasterized=as_array(mark.x).size > 2000,
            )
        case Stems():
            axes.vlines(as_array(mark.x), 0, as_array(mark.y), color=mark.color, linewidth=1)
        case Span():
            _draw_span(axes, mark)
        case Level():
            _draw_level(axes, mark)
        case HeatMap():
            _draw_map(axes, mark)


def _draw_line(axes: Any, line: Line) -> None:
    x = as_array(line.x)
    if line.low is not None and line.high is not None:
        low, high = as_array(line.low), as_array(line.high)
        axes.fill_between(x, low, high, color=line.color, alpha=0.18, linewidth=0)
    style = {
        "color": line.color,
        "linestyle": line.dashes,
        "linewidth": line.width,
        "marker": "o" if line.markers else None,
        "markersize": 3,
        "label": line.label,
    }
    if line.error is None:
        axes.plot(x, as_array(line.y), **style)
    else:
        axes.errorbar(x, as_array(line.y), as_array(line.error), capsize=2, **style)


def _draw_span(axes: Any, span: Span) -> None:
    across = axes.axvspan if span.axis == "x" else axes.axhspan
    if span.hatched:
        across(
            span.low,
            span.high,
            facecolor="none",
            edgecolor="0.4",
            hatch="///",
            linewidth=0,
            label=span.label,
        )
    else:
        across(
            span.low,
            span.high,
            color=span.color,
            alpha=span.opacity,
            linewidth=0,
            zorder=0.5,
            label=span.label,
        )


def _draw_level(axes: Any, level: Level) -> None:
    style = {
        "color": level.color,
        "linestyle": level.dashes,
        "linewidth": 0.9,
        "label": level.label,
        "zorder": 1.5,
    }
    if level.axis == "diagonal":
        axes.axline((0, 0), slope=1, **style)
    elif level.axis == "x":
        axes.axvline(level.value, **style)
    else:
        axes.axhline(level.value, **style)


def _draw_map(axes: Any, heat: HeatMap) -> None:
    values = as_array(heat.values)
    axes.grid(False)
    image = axes.pcolormesh(
        as_array(heat.x),
        as_array(heat.y),
        np.ma.masked_invalid(values),
        cmap="RdBu_r" if heat.diverging else "viridis",
        vmin=heat.low,
        vmax=heat.high,
        shading="nearest",
    )
    bar = axes.figure.colorbar(image, ax=axes, label=heat.label)
    bar.outline.set_visible(False)
    if heat.numbers is None:
        return
    for (row, column), value in np.ndenumerate(values):
        if not np.isfinite(value):
            continue
        red, green, blue, _ = image.cmap(image.norm(value))
        dark = 0.3 * red + 0.6 * green + 0.1 * blue < 0.5
        axes.text(
            as_array(heat.x)[column],
            as_array(heat.y)[row],
            f"{value:.{heat.numbers}f}",
            ha="center",
            va="center",
            fontsize="x-small",
            color="white" if dark else "black",
        )


def _scale(axis: Any, wanted: Axis) -> None:
    if wanted.log:
        axis._set_axes_scale("log")


def _finish(axis: Any, wanted: Axis, set_limits: Any) -> None:
    axis.set_label_text(wanted.label)
    if wanted.categories:
        axis.set_ticks(range(len(wanted.categories)), wanted.categories)
        axis.grid(False)
        if axis.axis_name == "x" and max(map(len, wanted.categories)) > 3:
            axis.set_tick_params(rotation=45)
    if wanted.low is not None or wanted.high is not None:
        set_limits(wanted.low, wanted.high)
    if wanted.log:
        _plain_numbers(axis)
    if wanted.reverse:
        axis.set_inverted(True)


def _plain_numbers(axis: Any) -> None:
    """Numbers as 1, 2, 5, 10, not as powers of ten, where they are of a readable size."""
    from matplotlib.ticker import FuncFormatter, LogLocator, NullLocator

    low, high = sorted(axis.get_view_interval())
    axis.set_minor_locator(NullLocator())
    if low < PLAIN[0] or high > PLAIN[1]:
        return
    few, many = high < DECADE * low, high > 1e3 * low
    subs = (1, 1.5, 2, 3, 4, 5, 6, 8) if few else (1,) if many else (1, 2, 5)
    axis.set_major_locator(LogLocator(subs=subs))
    axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))


def _legends(figure: Any, chart: Chart, drawn: Sequence[tuple[Panel, Any]]) -> None:
    if chart.legend and drawn:
        handles, labels = _handles(figure, drawn[0][1])
        figure.legend(handles, labels, loc="outside upper center", ncols=min(len(labels), 5))
        return
    for panel, axes in drawn:
        handles, labels = _handles(figure, axes)
        if panel.legend and labels:
            axes.legend(handles, labels, loc="best")


def _handles(figure: Any, axes: Any) -> tuple[list[Any], list[str]]:
    """Of the axes and of those drawn over them."""
    handles, labels = [], []
    for each in figure.axes:
        if each.get_subplotspec() is not None and each.get_subplotspec() == axes.get_subplotspec():
            found = each.get_legend_handles_labels()
            handles += found[0]
            labels += found[1]
    return handles, labels
