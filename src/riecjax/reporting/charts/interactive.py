"""Charts on a page: a Plotly figure in plain data, which zooms and tells values on hover."""

from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from riecjax.reporting.charts.chart import (
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
from riecjax.reporting.charts.layout import (
    LEFT,
    LEGEND,
    RIGHT,
    TITLE,
    Spaces,
    has_legend,
    places,
    plain_number,
    plain_text,
    plain_values,
    plotly_axis,
    reach_of,
    share_axis,
)

DASHES = {"solid": "solid", "dashed": "dash", "dotted": "dot", "dashdot": "dashdot"}
GREY_KEY = "#666666"
MAP = {
    False: "Viridis",
    # As matplotlib's RdBu_r.
    True: [
        [0.0, "#053061"],
        [0.1, "#2166ac"],
        [0.2, "#4393c3"],
        [0.3, "#92c5de"],
        [0.4, "#d1e5f0"],
        [0.5, "#f7f7f7"],
        [0.6, "#fddbc7"],
        [0.7, "#f4a582"],
        [0.8, "#d6604d"],
        [0.9, "#b2182b"],
        [1.0, "#67001f"],
    ],
}


def interactive(chart: Chart) -> dict[str, Any]:
    """Data and layout of a Plotly figure, ready for JSON."""
    figure = _Figure(chart)
    for row, place, panel in places(chart):
        figure.add(panel, row, place)
    return {"data": figure.data, "layout": figure.layout}


class _Figure:
    """A Plotly figure as it grows, panel by panel."""

    def __init__(self, chart: Chart):
        self.chart = chart
        self.spaces = Spaces.of(chart)
        self.data: list[dict[str, Any]] = []
        self.count = 0
        self.above: dict[int, str] = {}
        self.first_of_row: dict[int, str] = {}
        self.in_legend: set[tuple[str, str]] = set()
        self.layout: dict[str, Any] = {
            "height": round(self.spaces.height),
            "margin": {
                "l": LEFT,
                "r": RIGHT + self.spaces.right[-1],
                "t": self.spaces.above[0],
                "b": self.spaces.below[-1],
            },
            "font": {"family": "system-ui, sans-serif", "size": 12, "color": "#1a1a1a"},
            "paper_bgcolor": "rgba(0,0,0,0)",
            "plot_bgcolor": "rgba(0,0,0,0)",
            "separators": ".",
            "hovermode": "closest",
            "hoverlabel": {"namelength": -1},
            "shapes": [],
            "annotations": [],
        }

    def add(self, panel: Panel, row: int, place: int) -> None:
        """One panel with all its marks."""
        self.count += 1
        number = "" if self.count == 1 else str(self.count)
        across, down = self.spaces.across(place, panel.columns), self.spaces.along(row)
        x, y = (
            plotly_axis(panel.x, reach_of(panel, "x")),
            plotly_axis(panel.y, reach_of(panel, "y")),
        )
        if self.chart.share_x:
            share_axis(x, panel.x, self.above.setdefault(place, f"x{number}"), f"x{number}")
        if self.chart.share_y:
            share_axis(y, panel.y, self.first_of_row.setdefault(row, f"y{number}"), f"y{number}")
        self.layout[f"xaxis{number}"] = x | {"domain": across, "anchor": f"y{number}"}
        self.layout[f"yaxis{number}"] = y | {"domain": down, "anchor": f"x{number}"}
        axes = {"xaxis": f"x{number}", "yaxis": f"y{number}"}
        right = {"xaxis": f"x{number}", "yaxis": f"y{100 + self.count}"}
        if panel.right is not None:
            self.layout[f"yaxis{100 + self.count}"] = plotly_axis(
                panel.right, reach_of(panel, "right")
            ) | {
                "overlaying": f"y{number}",
                "side": "right",
                "anchor": f"x{number}",
                "showgrid": False,
                "tickmode": "auto",
            }
        self._titles(panel, across, down)
        for mark in panel.marks:
            self._mark(mark, right if isinstance(mark, Line) and mark.right else axes, panel)

    def _titles(self, panel: Panel, across: list[float], down: list[float]) -> None:
        """Title and legend, above the panel."""
        own = not self.chart.legend and has_legend(panel)
        all_in_one = self.chart.legend and self.count == 1
        if own or all_in_one:
            shift = (TITLE if all_in_one and panel.title else 0) / self.spaces.inside_height
            self.layout[self._legend] = {
                "orientation": "h",
                "x": across[0],
                "y": down[1] + shift,
                "xanchor": "left",
                "yanchor": "bottom",
                "bgcolor": "rgba(0,0,0,0)",
                "tracegroupgap": 4,
            }
        if panel.title:
            self.layout["annotations"].append(
                {
                    "text": f"<b>{plain_text(panel.title)}</b>",
                    "x": across[0],
                    "y": down[1],
                    "yshift": LEGEND if own else 2,
                    "xref": "paper",
                    "yref": "paper",
                    "xanchor": "left",
                    "yanchor": "bottom",
                    "showarrow": False,
                }
            )

    @property
    def _legend(self) -> str:
        return "legend" if self.chart.legend or self.count == 1 else f"legend{self.count}"

    def _named(self, label: str, panel: Panel) -> dict[str, Any]:
        """Name of a trace, which stands in a legend once."""
        key = (label, self._legend)
        shown = panel.legend and not (self.chart.legend and self.count > 1)
        first = bool(label) and shown and key not in self.in_legend
        self.in_legend.add(key)
        name = plain_text(label)
        return {
            "name": name,
            "legendgroup": name or None,
            "showlegend": first,
            "legend": self._legend,
        }

    def _mark(self, mark: Mark, axes: dict[str, str], panel: Panel) -> None:
        match mark:
            case Line():
                self._line(mark, axes, panel)
            case Dots():
                self._points(
                    mark,
                    axes,
                    panel,
                    {"size": 1.5 * mark.size, "opacity": mark.opacity},
                )
            case Stems():
                self._points(mark, axes, panel, {"size": 3}, error_y=_to_zero(mark))
            case Span():
                self._span(mark, axes, panel)
            case Level():
                self._level(mark, axes, panel)
            case HeatMap():
                self._map(mark, axes)

    def _points(
        self,
        mark: Dots | Stems,
        axes: dict[str, str],
        panel: Panel,
        marker: dict[str, Any],
        **settings: Any,
    ) -> None:
        self.data.append(
            {
                "type": "scatter",
                "mode": "markers",
                "x": plain_values(mark.x),
                "y": plain_values(mark.y),
                "marker": {"color": mark.color, **marker},
                **self._named(mark.label, panel),
                **axes,
                **settings,
            }
        )

    def _line(self, line: Line, axes: dict[str, str], panel: Panel) -> None:
        trace = {
            "type": "scatter",
            "mode": "lines+markers" if line.markers else "lines",
            "x": plain_values(line.x),
            "y": plain_values(line.y),
            "line": {
                "color": line.color,
                "dash": DASHES[line.dashes],
                "width": 1.2 * line.width,
            },
            "marker": {"size": 5},
            **self._named(line.label, panel),
            **axes,
        }
        if line.low is not None and line.high is not None:
            self.data.append(_band(line, line.low, line.high) | axes)
            ends = np.stack([as_array(line.low), as_array(line.high)], axis=-1)
            trace["customdata"] = [plain_values(pair) for pair in ends]
            trace["hovertemplate"] = "(%{x}, %{y})<br>%{customdata[0]} to %{customdata[1]}"
        if line.error is not None:
            trace["error_y"] = {"array": plain_values(line.error), "thickness": 1, "width": 3}
        self.data.append(trace)

    def _span(self, span: Span, axes: dict[str, str], panel: Panel) -> None:
        look: dict[str, Any] = {"fillcolor": span.color, "opacity": span.opacity}
        look["line"] = {"width": 0}
        key: dict[str, Any] = {"color": span.color, "opacity": span.opacity}
        if span.hatched:
            # Plotly has no hatching of shapes: an outline instead.
            edge = {"width": 1.5, "color": GREY_KEY}
            look = {"fillcolor": "rgba(0,0,0,0)", "line": edge | {"dash": "dash"}}
            key = {"color": "rgba(0,0,0,0)", "line": edge}
        self._shape("rect", span.axis, span.low, span.high, axes, look)
        if span.label:
            marker = {"symbol": "square", "size": 11, **key}
            self._key(span.label, {"mode": "markers", "marker": marker}, axes, panel)

    def _level(self, level: Level, axes: dict[str, str], panel: Panel) -> None:
        style = {"color": level.color, "dash": DASHES[level.dashes], "width": 1}
        look = {"mode": "lines", "line": style}
        if level.axis == "diagonal":
            ends = plain_values(reach_of(panel, "x"))
            self._key(level.label, {**look, "x": ends, "y": ends}, axes, panel)
            return
        self._shape("line", level.axis, level.value, level.value, axes, {"line": style})
        if level.label:
            self._key(level.label, look, axes, panel)

    def _shape(
        self,
        kind: str,
        along: str,
        low: float,
        high: float,
        axes: dict[str, str],
        look: dict[str, Any],
    ) -> None:
        """A stretch or a value of one axis, from end to end of the other."""
        across = "y" if along == "x" else "x"
        self.layout["shapes"].append(
            {
                "type": kind,
                # Lines would vanish under those of the grid.
                "layer": "below" if "fillcolor" in look and look["line"]["width"] == 0 else "above",
                f"{along}ref": axes[f"{along}axis"],
                f"{across}ref": f"{axes[f'{across}axis']} domain",
                f"{along}0": plain_number(low),
                f"{along}1": plain_number(high),
                f"{across}0": 0,
                f"{across}1": 1,
                **look,
            }
        )

    def _key(self, label: str, look: dict[str, Any], axes: dict[str, str], panel: Panel) -> None:
        """An entry of the legend for what has none of its own; nothing to point at."""
        self.data.append(
            {
                "type": "scatter",
                "x": [None],
                "y": [None],
                "hoverinfo": "skip",
                **look,
                **self._named(label, panel),
                **axes,
            }
        )

    def _map(self, heat: HeatMap, axes: dict[str, str]) -> None:
        number = axes["xaxis"].removeprefix("x")
        across = self.layout[f"xaxis{number}"]["domain"]
        down = self.layout[f"yaxis{number}"]["domain"]
        values = as_array(heat.values)
        low, high = heat.scale
        trace: dict[str, Any] = {
            "type": "heatmap",
            "x": plain_values(heat.x),
            "y": plain_values(heat.y),
            "z": [plain_values(row) for row in values],
            "colorscale": MAP[heat.diverging],
            "zmin": low,
            "zmax": high,
            "hoverongaps": False,
            "hovertemplate": _of_cell(self.layout[f"xaxis{number}"], self.layout[f"yaxis{number}"]),
            "colorbar": {
                "title": {"text": plain_text(heat.label), "side": "right"},
                "x": across[1],
                "xpad": 8,
                "y": sum(down) / 2,
                "len": down[1] - down[0],
                "thickness": 12,
                "outlinewidth": 0,
            },
            **axes,
        }
        if heat.numbers is not None:
            trace["texttemplate"] = f"%{{z:.{heat.numbers}f}}"
        names = [self.layout[f"{axis}axis{number}"].get("ticktext") for axis in "yx"]
        if any(names):
            y, x = (n or plain_values(v) for n, v in zip(names, (heat.y, heat.x)))
            trace["customdata"] = [[[one, other] for other in x] for one in y]
        self.data.append(trace)


def _of_cell(x: dict[str, Any], y: dict[str, Any]) -> str:
    """What a cell says: names of its place, where the axes have some."""
    where = "%{customdata[0]}, %{customdata[1]}" if "ticktext" in x | y else "%{x}, %{y}"
    return f"{where}: %{{z}}<extra></extra>"


def _band(line: Line, low: ArrayLike, high: ArrayLike) -> dict[str, Any]:
    """One closed outline for each unbroken stretch of a band."""
    x, low, high = (as_array(values).astype(float) for values in (line.x, low, high))
    whole = np.flatnonzero(np.isfinite(x) & np.isfinite(low) & np.isfinite(high))
    around_x: list[Any] = []
    around_y: list[Any] = []
    for part in np.split(whole, np.flatnonzero(np.diff(whole) > 1) + 1):
        back = part[::-1]
        around_x += [*plain_values(x[part]), *plain_values(x[back]), None]
        around_y += [*plain_values(high[part]), *plain_values(low[back]), None]
    return {
        "type": "scatter",
        "mode": "lines",
        "x": around_x,
        "y": around_y,
        "line": {"width": 0},
        "fill": "toself",
        "fillcolor": _translucent(line.color, 0.18),
        "hoverinfo": "skip",
        "showlegend": False,
        "legendgroup": plain_text(line.label) or None,
    }


def _to_zero(stems: Stems) -> dict[str, Any]:
    """Bars from each value back to zero."""
    y = as_array(stems.y)
    return {
        "symmetric": False,
        "array": plain_values(np.maximum(-y, 0)),
        "arrayminus": plain_values(np.maximum(y, 0)),
        "color": stems.color,
        "thickness": 1.2,
        "width": 0,
    }


def _translucent(color: str, opacity: float) -> str:
    red, green, blue = (int(color[i : i + 2], 16) for i in (1, 3, 5))
    return f"rgba({red},{green},{blue},{opacity})"
