"""Marks as Plotly's traces and shapes, in plain data."""

import html
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from riecjax.reporting.charts.chart import Dots, HeatMap, Level, Line, Mark, Panel, Span, Stems

DIGITS = 6
"""Significant digits of a value on a page: more than a screen shows, and a smaller file."""
DASHES = {"solid": "solid", "dashed": "dash", "dotted": "dot", "dashdot": "dashdot"}
GREY_KEY, CLEAR = "#666666", "rgba(0,0,0,0)"
RED_BLUE = (
    "#053061", "#2166ac", "#4393c3", "#92c5de", "#d1e5f0", "#f7f7f7", "#fddbc7", "#f4a582",
    "#d6604d", "#b2182b", "#67001f",
)  # fmt: skip
"""As matplotlib's RdBu_r, in steps of a tenth."""


def plain_values(values: ArrayLike) -> list[float | None]:
    """Numbers for JSON, in one list: rounded for the page, a gap where there is no number."""
    return [
        float(f"{value:.{DIGITS}g}") if np.isfinite(value) else None
        for value in np.ravel(values).tolist()
    ]


def plain_text(text: str) -> str:
    """Plotly reads a little HTML in texts."""
    return html.escape(text, quote=False)


def traces(mark: Mark, panel: Panel) -> list[dict[str, Any]]:
    """Traces of a mark, without their axes; those with a `name` stand in a legend by it.

    A stretch or a value of an axis is a shape, and has a trace for its legend only.
    """
    match mark:
        case Line():
            return _line(mark)
        case Dots():
            marker = {"color": mark.color, "size": 1.5 * mark.size, "opacity": mark.opacity}
            return [_scatter(mark, "markers", marker=marker)]
        case Stems():
            marker = {"color": mark.color, "size": 3}
            return [_scatter(mark, "markers", marker=marker, error_y=_to_zero(mark))]
        case Span():
            key = {"color": mark.color, "opacity": mark.opacity}
            if mark.hatched:
                key = {"color": CLEAR, "line": {"width": 1.5, "color": GREY_KEY}}
            marker = {"symbol": "square", "size": 11, **key}
            return [_key(mark, mode="markers", marker=marker)] if mark.label else []
        case Level():
            style = {"mode": "lines", "line": _level_style(mark)}
            if mark.axis == "diagonal":
                ends = plain_values(panel.reach("x"))
                return [_key(mark, **style, x=ends, y=ends)]
            return [_key(mark, **style)] if mark.label else []
        case HeatMap():
            return [_map(mark, panel)]


def shapes(mark: Mark, axes: dict[str, str]) -> list[dict[str, Any]]:
    """Stretches and values of one axis, from end to end of the other."""
    if isinstance(mark, Span):
        low, high = mark.low, mark.high
        look = {"type": "rect", "layer": "below", "fillcolor": mark.color, "line": {"width": 0}}
        look["opacity"] = mark.opacity
        if mark.hatched:
            # Plotly has no hatching of shapes: an outline instead.
            line = {"width": 1.5, "color": GREY_KEY, "dash": "dash"}
            look = {"type": "rect", "layer": "above", "fillcolor": CLEAR, "line": line}
    elif isinstance(mark, Level) and mark.axis != "diagonal":
        low = high = mark.value
        # Below, it would vanish under a line of the grid.
        look = {"type": "line", "layer": "above", "line": _level_style(mark)}
    else:
        return []
    along, across = mark.axis, "y" if mark.axis == "x" else "x"
    look |= {f"{along}ref": axes[f"{along}axis"], f"{across}ref": f"{axes[f'{across}axis']} domain"}
    start, stop = plain_values([low, high])
    return [look | {f"{along}0": start, f"{along}1": stop, f"{across}0": 0, f"{across}1": 1}]


def _scatter(mark: Line | Dots | Stems, mode: str, **settings: Any) -> dict[str, Any]:
    x, y = plain_values(mark.x), plain_values(mark.y)
    return {"type": "scatter", "mode": mode, "x": x, "y": y, "name": mark.label, **settings}


def _key(mark: Span | Level, **settings: Any) -> dict[str, Any]:
    """An entry of the legend for what has none of its own; nothing to point at."""
    trace = {"type": "scatter", "x": [None], "y": [None], "hoverinfo": "skip", "name": mark.label}
    return trace | settings


def _line(line: Line) -> list[dict[str, Any]]:
    style = {"color": line.color, "dash": DASHES[line.dashes], "width": 1.2 * line.width}
    mode = "lines+markers" if line.markers else "lines"
    trace = _scatter(line, mode, line=style, marker={"size": 5})
    if line.error is not None:
        trace["error_y"] = {"array": plain_values(line.error), "thickness": 1, "width": 3}
    if line.low is None or line.high is None:
        return [trace]
    trace["customdata"] = [plain_values(pair) for pair in np.column_stack((line.low, line.high))]
    trace["hovertemplate"] = "(%{x}, %{y})<br>%{customdata[0]} to %{customdata[1]}"
    return [_band(line, line.low, line.high), trace]


def _band(line: Line, low: ArrayLike, high: ArrayLike) -> dict[str, Any]:
    """One closed outline for each unbroken stretch of a band."""
    x, low, high = (np.asarray(values, float) for values in (line.x, low, high))
    whole = np.flatnonzero(np.isfinite(x) & np.isfinite(low) & np.isfinite(high))
    around: list[np.ndarray] = []
    for part in np.split(whole, np.flatnonzero(np.diff(whole) > 1) + 1):
        there = np.column_stack((x[part], high[part]))
        back = np.column_stack((x[part], low[part]))[::-1]
        around += [there, back, np.full((1, 2), np.nan)]
    x, y = np.concatenate(around).T
    red, green, blue = (int(line.color[i : i + 2], 16) for i in (1, 3, 5))
    return {
        "type": "scatter",
        "mode": "lines",
        "x": plain_values(x),
        "y": plain_values(y),
        "line": {"width": 0},
        "fill": "toself",
        "fillcolor": f"rgba({red},{green},{blue},0.18)",
        "hoverinfo": "skip",
        "showlegend": False,
        "legendgroup": plain_text(line.label) or None,
    }


def _to_zero(stems: Stems) -> dict[str, Any]:
    """Bars from each value back to zero."""
    y = np.asarray(stems.y)
    up, down = plain_values(np.maximum(-y, 0)), plain_values(np.maximum(y, 0))
    look = {"color": stems.color, "thickness": 1.2, "width": 0}
    return {"symmetric": False, "array": up, "arrayminus": down, **look}


def _level_style(level: Level) -> dict[str, Any]:
    return {"color": level.color, "dash": DASHES[level.dashes], "width": 1}


def _map(heat: HeatMap, panel: Panel) -> dict[str, Any]:
    """The map; a cell tells the names of its place, where the axes have some."""
    low, high = heat.scale
    x, y = plain_values(heat.x), plain_values(heat.y)
    stops = [[i / 10, color] for i, color in enumerate(RED_BLUE)]
    trace: dict[str, Any] = {
        "type": "heatmap",
        "x": x,
        "y": y,
        "z": [plain_values(row) for row in np.asarray(heat.values)],
        "colorscale": stops if heat.diverging else "Viridis",
        "zmin": low,
        "zmax": high,
        "hoverongaps": False,
        "hovertemplate": "%{x}, %{y}: %{z}<extra></extra>",
        "colorbar": {
            "title": {"text": plain_text(heat.label), "side": "right"},
            "xpad": 8,
            "thickness": 12,
            "outlinewidth": 0,
        },
    }
    if heat.numbers is not None:
        trace["texttemplate"] = f"%{{z:.{heat.numbers}f}}"
    if panel.x.categories or panel.y.categories:
        columns = [plain_text(name) for name in panel.x.categories] or x
        rows = [plain_text(name) for name in panel.y.categories] or y
        trace["customdata"] = [[[row, column] for column in columns] for row in rows]
        trace["hovertemplate"] = "%{customdata[0]}, %{customdata[1]}: %{z}<extra></extra>"
    return trace
