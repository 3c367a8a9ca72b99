"""Charts on a page: a Plotly figure in plain data, which zooms and tells values on hover."""

from typing import Any

import numpy as np
from numpy.typing import ArrayLike

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

PIXELS = 84
"""To an inch of the printed figure, in height; the width is the page's."""
DIGITS = 5
"""Significant digits of a value on a page: more than a screen shows, and a smaller file."""
DASHES = {"solid": "solid", "dashed": "dash", "dotted": "dot", "dashdot": "dashdot"}
GAP_X, GAP_Y = 0.09, 0.14
"""Space between panels, as shares of the whole."""
WITH_COLOUR_BAR = 0.86
"""Share of its place that a panel with a colour bar keeps."""


def interactive(chart: Chart) -> dict[str, Any]:
    """Data and layout of a Plotly figure, ready for JSON."""
    figure = _Figure(chart)
    for i, row in enumerate(chart.rows):
        place = 0
        for panel in row:
            if panel is not None:
                figure.add(panel, i, place)
            place += 1 if panel is None else panel.columns
    return {"data": figure.data, "layout": figure.layout}


class _Figure:
    """A Plotly figure as it grows, panel by panel."""

    def __init__(self, chart: Chart):
        self.chart = chart
        self.data: list[dict[str, Any]] = []
        self.count = 0
        self.above: dict[int, str] = {}
        self.first_of_row: dict[int, str] = {}
        self.legends: set[str] = set()
        self.layout: dict[str, Any] = {
            "height": round(PIXELS * chart.size[1]) + 40,
            "margin": {"l": 64, "r": 16, "t": 36, "b": 48},
            "font": {"family": "system-ui, sans-serif", "size": 12},
            "paper_bgcolor": "rgba(0,0,0,0)",
            "plot_bgcolor": "rgba(0,0,0,0)",
            "hovermode": "closest",
            "legend": {"orientation": "h", "y": 1.02, "yanchor": "bottom", "x": 0},
            "shapes": [],
            "annotations": [],
        }

    def add(self, panel: Panel, row: int, place: int) -> None:
        """One panel with all its marks."""
        self.count += 1
        number = "" if self.count == 1 else str(self.count)
        across, down = self._place(panel, row, place)
        self.layout[f"xaxis{number}"] = _axis(panel.x) | {"domain": across, "anchor": f"y{number}"}
        self.layout[f"yaxis{number}"] = _axis(panel.y) | {"domain": down, "anchor": f"x{number}"}
        if self.chart.share_x and place in self.above:
            self.layout[f"xaxis{number}"]["matches"] = self.above[place]
        if self.chart.share_y and row in self.first_of_row:
            self.layout[f"yaxis{number}"]["matches"] = self.first_of_row[row]
        self.above.setdefault(place, f"x{number}")
        self.first_of_row.setdefault(row, f"y{number}")
        axes = {"xaxis": f"x{number}", "yaxis": f"y{number}"}
        right = {"xaxis": f"x{number}", "yaxis": f"y{100 + self.count}"}
        if panel.right is not None:
            self.layout[f"yaxis{100 + self.count}"] = _axis(panel.right) | {
                "overlaying": f"y{number}",
                "side": "right",
                "anchor": f"x{number}",
                "showgrid": False,
            }
        if panel.title:
            self._title(panel.title, across, down)
        for mark in panel.marks:
            self._mark(mark, right if isinstance(mark, Line) and mark.right else axes, panel)

    def _place(self, panel: Panel, row: int, place: int) -> tuple[list[float], list[float]]:
        columns, rows = self.chart.columns, len(self.chart.rows)
        width = (1 - GAP_X * (columns - 1)) / columns
        left = place * (width + GAP_X)
        across = [left, left + panel.columns * width + (panel.columns - 1) * GAP_X]
        if any(isinstance(mark, HeatMap) for mark in panel.marks):
            across[1] = across[0] + WITH_COLOUR_BAR * (across[1] - across[0])
        heights = np.array(self.chart.heights or (1.0,) * rows)
        gap = GAP_Y * 2 / max(rows, 2) if rows > 1 else 0.0
        shares = heights / heights.sum() * (1 - gap * (rows - 1))
        top = 1 - float(shares[:row].sum()) - gap * row
        return across, [max(top - float(shares[row]), 0.0), top]

    def _title(self, title: str, across: list[float], down: list[float]) -> None:
        self.layout["annotations"].append(
            {
                "text": title,
                "x": sum(across) / 2,
                "y": down[1],
                "xref": "paper",
                "yref": "paper",
                "xanchor": "center",
                "yanchor": "bottom",
                "showarrow": False,
            }
        )

    def _named(self, label: str, panel: Panel) -> dict[str, Any]:
        """Name of a trace; the same name in several panels stands in the legend once."""
        first = bool(label) and label not in self.legends and panel.legend
        self.legends.add(label)
        return {"name": label, "legendgroup": label or None, "showlegend": first}

    def _mark(self, mark: Mark, axes: dict[str, str], panel: Panel) -> None:
        match mark:
            case Line():
                self._line(mark, axes, panel)
            case Dots():
                self.data.append(
                    {
                        "type": "scattergl" if as_array(mark.x).size > 2000 else "scatter",
                        "mode": "markers",
                        "x": _values(mark.x),
                        "y": _values(mark.y),
                        "marker": {
                            "color": mark.color,
                            "size": 1.5 * mark.size,
                            "opacity": mark.opacity,
                        },
                        **self._named(mark.label, panel),
                        **axes,
                    }
                )
            case Stems():
                self._stems(mark, axes, panel)
            case Span():
                self._span(mark, axes, panel)
            case Level():
                self._level(mark, axes, panel)
            case HeatMap():
                self._map(mark, axes)

    def _line(self, line: Line, axes: dict[str, str], panel: Panel) -> None:
        named = self._named(line.label, panel)
        if line.low is not None and line.high is not None:
            self.data += _band(line, {**named, "showlegend": False}, axes)
        trace = {
            "type": "scatter",
            "mode": "lines+markers" if line.markers else "lines",
            "x": _values(line.x),
            "y": _values(line.y),
            "line": {
                "color": line.color,
                "dash": DASHES[line.dashes],
                "width": 1.2 * line.width,
            },
            "marker": {"size": 5},
            **named,
            **axes,
        }
        if line.low is not None and line.high is not None:
            ends = np.stack([as_array(line.low), as_array(line.high)], axis=-1)
            trace["customdata"] = [_values(pair) for pair in ends]
            trace["hovertemplate"] = "%{x}: %{y}<br>%{customdata[0]} to %{customdata[1]}"
        if line.error is not None:
            trace["error_y"] = {"array": _values(line.error), "thickness": 1, "width": 3}
        self.data.append(trace)

    def _stems(self, stems: Stems, axes: dict[str, str], panel: Panel) -> None:
        x, y = as_array(stems.x), as_array(stems.y)
        there, from_zero = np.repeat(x, 3), np.stack([0 * y, y, np.full_like(y, np.nan)], axis=1)
        self.data.append(
            {
                "type": "scatter",
                "mode": "lines",
                "x": _values(there),
                "y": _values(from_zero.ravel()),
                "line": {"color": stems.color, "width": 1.2},
                **self._named(stems.label, panel),
                **axes,
            }
        )

    def _span(self, span: Span, axes: dict[str, str], panel: Panel) -> None:
        along, across = ("x", "y") if span.axis == "x" else ("y", "x")
        fill = {"fillcolor": span.color, "opacity": span.opacity, "line": {"width": 0}}
        if span.hatched:
            fill = {
                "fillcolor": "rgba(0,0,0,0)",
                "line": {"width": 1, "dash": "dot", "color": "#666666"},
            }
        self.layout["shapes"].append(
            {
                "type": "rect",
                "layer": "below",
                f"{along}ref": axes[f"{along}axis"],
                f"{across}ref": f"{axes[f'{across}axis']} domain",
                f"{along}0": _number(span.low),
                f"{along}1": _number(span.high),
                f"{across}0": 0,
                f"{across}1": 1,
                **fill,
            }
        )
        if span.label:
            color = "#666666" if span.hatched else span.color
            self._key(span.label, {"color": color, "width": 8}, axes, panel)

    def _level(self, level: Level, axes: dict[str, str], panel: Panel) -> None:
        style = {"color": level.color, "dash": DASHES[level.dashes], "width": 1}
        if level.axis == "diagonal":
            ends = _reach(panel)
            self.data.append(
                {
                    "type": "scatter",
                    "mode": "lines",
                    "x": ends,
                    "y": ends,
                    "line": style,
                    "hoverinfo": "skip",
                    **self._named(level.label, panel),
                    **axes,
                }
            )
            return
        along, across = (level.axis, "y" if level.axis == "x" else "x")
        self.layout["shapes"].append(
            {
                "type": "line",
                "layer": "below",
                f"{along}ref": axes[f"{along}axis"],
                f"{across}ref": f"{axes[f'{across}axis']} domain",
                f"{along}0": level.value,
                f"{along}1": level.value,
                f"{across}0": 0,
                f"{across}1": 1,
                "line": style,
            }
        )
        if level.label:
            self._key(level.label, style, axes, panel)

    def _key(
        self, label: str, style: dict[str, Any], axes: dict[str, str], panel: Panel
    ) -> None:
        """An entry of the legend for a shape, which has none of its own."""
        self.data.append(
            {
                "type": "scatter",
                "mode": "lines",
                "x": [None],
                "y": [None],
                "line": style,
                **self._named(label, panel),
                **axes,
            }
        )

    def _map(self, heat: HeatMap, axes: dict[str, str]) -> None:
        number = axes["xaxis"].removeprefix("x")
        across = self.layout[f"xaxis{number}"]["domain"]
        down = self.layout[f"yaxis{number}"]["domain"]
        trace: dict[str, Any] = {
            "type": "heatmap",
            "x": _values(heat.x),
            "y": _values(heat.y),
            "z": [_values(row) for row in as_array(heat.values)],
            "colorscale": "RdBu" if heat.diverging else "Viridis",
            "reversescale": heat.diverging,
            "zmin": heat.low,
            "zmax": heat.high,
            "hovertemplate": "%{x}, %{y}: %{z}<extra></extra>",
            "colorbar": {
                "title": {"text": heat.label, "side": "right"},
                "x": across[1] + 0.01,
                "y": sum(down) / 2,
                "len": down[1] - down[0],
                "thickness": 12,
                "outlinewidth": 0,
            },
            **axes,
        }
        if heat.numbers is not None:
            trace["texttemplate"] = f"%{{z:.{heat.numbers}f}}"
        self.data.append(trace)


def _band(line: Line, named: dict[str, Any], axes: dict[str, str]) -> list[dict[str, Any]]:
    """Two invisible lines with colour between them."""
    edge = {
        "type": "scatter",
        "mode": "lines",
        "x": _values(line.x),
        "line": {"width": 0},
        "hoverinfo": "skip",
        **named,
        **axes,
    }
    return [
        {**edge, "y": _values(line.low if line.low is not None else [])},
        {
            **edge,
            "y": _values(line.high if line.high is not None else []),
            "fill": "tonexty",
            "fillcolor": _translucent(line.color, 0.18),
        },
    ]


def _axis(wanted: Axis) -> dict[str, Any]:
    axis: dict[str, Any] = {
        "title": {"text": wanted.label, "standoff": 6},
        "type": "log" if wanted.log else "linear",
        "gridcolor": "#ececec",
        "zeroline": False,
        "linecolor": "#555555",
        "ticks": "outside",
        "automargin": True,
    }
    if wanted.log:
        axis |= {"dtick": "D2", "exponentformat": "power"}
    if wanted.categories:
        axis |= {
            "tickvals": list(range(len(wanted.categories))),
            "ticktext": list(wanted.categories),
            "showgrid": False,
        }
    ends = [wanted.low, wanted.high]
    if wanted.log:
        ends = [None if end is None else float(np.log10(end)) for end in ends]
    if any(end is not None for end in ends):
        axis["range"] = [None if end is None else _number(end) for end in ends]
    if wanted.reverse:
        axis["autorange"] = "reversed"
    return axis


def _reach(panel: Panel) -> list[float]:
    """Ends of a sloped line: the axis', or the data's."""
    if panel.x.low is not None and panel.x.high is not None:
        return [panel.x.low, panel.x.high]
    drawn = [as_array(m.x) for m in panel.marks if isinstance(m, Line | Dots)]
    values = np.concatenate([np.atleast_1d(x) for x in drawn]) if drawn else np.array([0.0, 1.0])
    return [_number(float(np.nanmin(values))) or 0.0, _number(float(np.nanmax(values))) or 1.0]


def _values(values: ArrayLike) -> list[Any]:
    return [_number(value) for value in as_array(values).ravel().tolist()]


def _number(value: float) -> float | None:
    """Rounded for the page; a gap where there is no number."""
    return float(f"{value:.{DIGITS}g}") if np.isfinite(value) else None


def _translucent(color: str, opacity: float) -> str:
    red, green, blue = (int(color[i : i + 2], 16) for i in (1, 3, 5))
    return f"rgba({red},{green},{blue},{opacity})"
