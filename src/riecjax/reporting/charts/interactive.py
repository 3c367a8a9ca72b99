"""Charts on a page: a Plotly figure in plain data, which zooms and tells values on hover."""

import html
from collections.abc import Iterator
from typing import Any, Literal, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from riecjax.reporting.charts.chart import (
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
    Stems,
    as_array,
)

PIXELS = 88
"""To an inch of the printed figure, in height; the width is the page's."""
DIGITS = 6
"""Significant digits of a value on a page: more than a screen shows, and a smaller file."""
DASHES = {"solid": "solid", "dashed": "dash", "dotted": "dot", "dashdot": "dashdot"}
NARROWEST_PANEL = 210
"""Width in pixels of a panel without its numbers and labels, below which a page scrolls."""
WIDEST_LEGEND = 380
LEFT, RIGHT, BOTTOM, BARE_BOTTOM = 62, 14, 46, 12
"""Pixels about a panel: numbers and label of its axes, or ticks alone."""
RIGHT_AXIS, COLOUR_BAR = 56, 78
TITLE, LEGEND = 20, 26
LETTER, KEY = 6.2, 40
"""Pixels of a letter, and of a sign with its gaps, in a legend."""
MARGIN = 0.04
"""Share of an axis between the data and an end that is not given."""
FEW_NUMBERS = 4
"""Numbers that a logarithmic axis aims at: 1, 2, 5 up to three decades, else powers of ten."""
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
    for row, place, panel in _places(chart):
        figure.add(panel, row, place)
    return {"data": figure.data, "layout": figure.layout}


def narrowest(chart: Chart) -> int:
    """Width in pixels below which a chart should be scrolled, not squashed."""
    return round(_Spaces.of(chart).width)


def _places(chart: Chart) -> Iterator[tuple[int, int, Panel]]:
    """Each panel with its row and its first column."""
    for i, row in enumerate(chart.rows):
        place = 0
        for panel in row:
            if panel is not None:
                yield i, place, panel
            place += 1 if panel is None else panel.columns


class _Spaces(NamedTuple):
    """Where panels are: pixels across at the narrowest, and down.

    **Fields:** `panel`, width of one; `right` of each column, for axes and colour bars there;
    `above` and `below` each row, for titles, legends and numbers; `down`, heights of the rows.
    """

    panel: float
    right: list[int]
    above: list[int]
    below: list[int]
    down: list[float]

    @classmethod
    def of(cls, chart: Chart) -> "_Spaces":
        rows = len(chart.rows)
        panel = float(NARROWEST_PANEL)
        right, above, below = [0] * chart.columns, [6] * rows, [BARE_BOTTOM] * rows
        for row, place, one in _places(chart):
            last = place + one.columns - 1
            right[last] = max(right[last], _right_of(one))
            above[row] = max(above[row], _above(one, chart))
            if one.x.label or not chart.share_x:
                below[row] = BOTTOM
            # A legend that is wider than its panel would push the others aside.
            if chart.columns > 1 and not chart.legend:
                panel = max(panel, min(_legend_width(one) / one.columns, WIDEST_LEGEND))
        if chart.legend:
            above[0] += LEGEND
        heights = np.array(chart.heights or (1.0,) * rows)
        room = max(PIXELS * chart.size[1] - sum(above) - sum(below), 110.0 * rows)
        return cls(panel, right, above, below, (room * heights / heights.sum()).tolist())

    @property
    def width(self) -> float:
        """Of everything, at the narrowest."""
        return len(self.right) * (self.panel + LEFT) + sum(self.right) + RIGHT

    @property
    def height(self) -> float:
        """Of everything."""
        return sum(self.down) + sum(self.above) + sum(self.below)

    @property
    def inside_height(self) -> float:
        """Height inside the margins."""
        return self.height - self.above[0] - self.below[-1]

    def across(self, place: int, columns: int) -> list[float]:
        """Ends of a panel, as shares of the width inside the margins."""
        inside = self.width - LEFT - RIGHT - self.right[-1]
        gaps = [right + LEFT for right in self.right]
        start = sum(gaps[:place]) + place * self.panel
        stop = start + columns * self.panel + sum(gaps[place : place + columns - 1])
        return [start / inside, min(stop / inside, 1.0)]

    def along(self, row: int) -> list[float]:
        """Bottom and top of a row, as shares of the height inside the margins."""
        top = sum(self.down[:row]) + sum(self.above[1 : row + 1]) + sum(self.below[:row])
        bottom = 1 - (top + self.down[row]) / self.inside_height
        return [max(bottom, 0.0), 1 - top / self.inside_height]


def _right_of(panel: Panel) -> int:
    if any(isinstance(mark, HeatMap) for mark in panel.marks):
        return COLOUR_BAR
    return 0 if panel.right is None else RIGHT_AXIS


def _above(panel: Panel, chart: Chart) -> int:
    own = not chart.legend and _has_legend(panel)
    return 6 + TITLE * bool(panel.title) + LEGEND * own


def _has_legend(panel: Panel) -> bool:
    return panel.legend and bool(_labels(panel))


def _labels(panel: Panel) -> set[str]:
    named = (mark for mark in panel.marks if not isinstance(mark, HeatMap))
    return {mark.label for mark in named} - {""}


def _legend_width(panel: Panel) -> float:
    return sum(LETTER * len(label) + KEY for label in _labels(panel)) if panel.legend else 0.0


class _Figure:
    """A Plotly figure as it grows, panel by panel."""

    def __init__(self, chart: Chart):
        self.chart = chart
        self.spaces = _Spaces.of(chart)
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
        x, y = _axis(panel.x, _reach(panel, "x")), _axis(panel.y, _reach(panel, "y"))
        if self.chart.share_x:
            _share(x, panel.x, self.above.setdefault(place, f"x{number}"), f"x{number}")
        if self.chart.share_y:
            _share(y, panel.y, self.first_of_row.setdefault(row, f"y{number}"), f"y{number}")
        self.layout[f"xaxis{number}"] = x | {"domain": across, "anchor": f"y{number}"}
        self.layout[f"yaxis{number}"] = y | {"domain": down, "anchor": f"x{number}"}
        axes = {"xaxis": f"x{number}", "yaxis": f"y{number}"}
        right = {"xaxis": f"x{number}", "yaxis": f"y{100 + self.count}"}
        if panel.right is not None:
            self.layout[f"yaxis{100 + self.count}"] = _axis(panel.right, _reach(panel, "right")) | {
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
        own = not self.chart.legend and _has_legend(panel)
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
                    "text": f"<b>{_text(panel.title)}</b>",
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
        name = _text(label)
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
                "x": _values(mark.x),
                "y": _values(mark.y),
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
            "x": _values(line.x),
            "y": _values(line.y),
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
            trace["customdata"] = [_values(pair) for pair in ends]
            trace["hovertemplate"] = "(%{x}, %{y})<br>%{customdata[0]} to %{customdata[1]}"
        if line.error is not None:
            trace["error_y"] = {"array": _values(line.error), "thickness": 1, "width": 3}
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
            ends = _values(_reach(panel, "x"))
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
                f"{along}0": _number(low),
                f"{along}1": _number(high),
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
            "x": _values(heat.x),
            "y": _values(heat.y),
            "z": [_values(row) for row in values],
            "colorscale": MAP[heat.diverging],
            "zmin": low,
            "zmax": high,
            "hoverongaps": False,
            "hovertemplate": _of_cell(self.layout[f"xaxis{number}"], self.layout[f"yaxis{number}"]),
            "colorbar": {
                "title": {"text": _text(heat.label), "side": "right"},
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
            y, x = (n or _values(v) for n, v in zip(names, (heat.y, heat.x)))
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
        around_x += [*_values(x[part]), *_values(x[back]), None]
        around_y += [*_values(high[part]), *_values(low[back]), None]
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
        "legendgroup": _text(line.label) or None,
    }


def _to_zero(stems: Stems) -> dict[str, Any]:
    """Bars from each value back to zero."""
    y = as_array(stems.y)
    return {
        "symmetric": False,
        "array": _values(np.maximum(-y, 0)),
        "arrayminus": _values(np.maximum(y, 0)),
        "color": stems.color,
        "thickness": 1.2,
        "width": 0,
    }


def _axis(wanted: Axis, reach: tuple[float, float]) -> dict[str, Any]:
    axis: dict[str, Any] = {
        "title": {"text": _text(wanted.label), "standoff": 6},
        "type": "log" if wanted.log else "linear",
        "gridcolor": "#ececec",
        "zeroline": False,
        "linecolor": "#555555",
        "ticks": "outside",
        "ticklen": 4,
        "tickcolor": "#999999",
        "automargin": True,
        "exponentformat": "power",
        "minexponent": 5,
        "hoverformat": f".{DIGITS}~g",
    }
    if wanted.log and reach[0] >= PLAIN[0] and reach[1] <= PLAIN[1]:
        axis |= {"nticks": FEW_NUMBERS, "tickformat": "~g"}
    if wanted.color:
        axis |= {"color": wanted.color}
    if wanted.categories:
        axis |= {
            "tickvals": list(range(len(wanted.categories))),
            "ticktext": [_text(name) for name in wanted.categories],
            "showgrid": False,
        }
    return axis | _ends(wanted, reach)


def _ends(wanted: Axis, reach: tuple[float, float]) -> dict[str, Any]:
    """Range of an axis: Plotly finds both ends itself or neither."""
    if wanted.low is None and wanted.high is None:
        return {"autorange": "reversed"} if wanted.reverse else {}
    ends = np.log10(reach) if wanted.log else np.asarray(reach)
    margin = MARGIN * (ends[1] - ends[0])
    low = ends[0] - margin * (wanted.low is None)
    high = ends[1] + margin * (wanted.high is None)
    return {"range": _values([high, low] if wanted.reverse else [low, high])}


def _share(axis: dict[str, Any], wanted: Axis, first: str, own: str) -> None:
    if first != own:
        axis["matches"] = first
    if not wanted.label:
        axis["showticklabels"] = False


def _reach(panel: Panel, which: Literal["x", "y", "right"]) -> tuple[float, float]:
    """Ends of an axis: those given, or the data's."""
    axis = {"x": panel.x, "y": panel.y, "right": panel.right or Axis()}[which]
    drawn = [np.array([])]
    for mark in panel.marks:
        if isinstance(mark, Line | Dots | Stems):
            right = isinstance(mark, Line) and mark.right
            if which == "x" or right == (which == "right"):
                drawn.append(as_array(mark.x if which == "x" else mark.y).ravel())
    values = np.concatenate(drawn)
    values = values[np.isfinite(values)]
    least, most = (float(values.min()), float(values.max())) if values.size else (0.0, 1.0)
    return (least if axis.low is None else axis.low, most if axis.high is None else axis.high)


def _values(values: ArrayLike) -> list[Any]:
    return [_number(value) for value in as_array(values).ravel().tolist()]


def _number(value: float) -> float | None:
    """Rounded for the page; a gap where there is no number."""
    return float(f"{value:.{DIGITS}g}") if np.isfinite(value) else None


def _text(text: str) -> str:
    """Plotly reads a little HTML in texts."""
    return html.escape(text, quote=False)


def _translucent(color: str, opacity: float) -> str:
    red, green, blue = (int(color[i : i + 2], 16) for i in (1, 3, 5))
    return f"rgba({red},{green},{blue},{opacity})"
