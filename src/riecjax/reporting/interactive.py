"""Charts on a page: a Plotly figure in plain data, which zooms and tells values on hover."""

import html
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

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

PIXELS = 88
"""To an inch of the printed figure, in height; the width is the page's."""
NARROWEST_PANEL = 210
"""Width in pixels of a panel without its numbers and labels, below which a page scrolls."""
WIDEST_LEGEND = 380
LEFT, RIGHT, BOTTOM, BARE_BOTTOM = 62, 14, 46, 12
"""Pixels about a panel: numbers and label of its axes, or ticks alone."""
COLOUR_BAR = 78
GAP, TITLE, LEGEND = 6, 20, 26
"""Pixels above a panel."""
LETTER, KEY = 6.2, 40
"""Pixels of a letter, and of a sign with its gaps, in a legend."""
LOWEST_ROW = 110.0


class Spaces(NamedTuple):
    """Pixels across at the narrowest, and down.

    **Fields:** `panel`, width of one; `right` of each column, for colour bars there;
    `above` and `below` each row, for titles, legends and numbers; `down`, height of a row.
    """

    panel: float
    right: list[int]
    above: list[int]
    below: list[int]
    down: float

    @classmethod
    def of(cls, chart: Chart) -> "Spaces":
        """Of a chart, with room for all its numbers, titles and legends."""
        rows = len(chart.rows)
        width = float(NARROWEST_PANEL)
        right, above, below = [0] * chart.columns, [GAP] * rows, [BARE_BOTTOM] * rows
        for row, place, panel in chart.places:
            last = place + panel.columns - 1
            if any(isinstance(mark, HeatMap) for mark in panel.marks):
                right[last] = COLOUR_BAR
            legend = LEGEND * (bool(panel.labels) and not chart.legend)
            above[row] = max(above[row], GAP + TITLE * bool(panel.title) + legend)
            if panel.x.label or not chart.share_x:
                below[row] = BOTTOM
            # A legend that is wider than its panel would push the others aside.
            if chart.columns > 1 and not chart.legend:
                needed = sum(LETTER * len(label) + KEY for label in panel.labels)
                width = max(width, min(needed / panel.columns, WIDEST_LEGEND))
        if chart.legend:
            above[0] += LEGEND
        room = PIXELS * chart.size[1] - sum(above) - sum(below)
        return cls(width, right, above, below, max(room / rows, LOWEST_ROW))

    @property
    def width(self) -> float:
        """Of everything: below it, a chart should be scrolled, not squashed."""
        return len(self.right) * (self.panel + LEFT) + sum(self.right) + RIGHT

    @property
    def height(self) -> float:
        """Of everything."""
        return len(self.above) * self.down + sum(self.above) + sum(self.below)

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
        top = row * self.down + sum(self.above[1 : row + 1]) + sum(self.below[:row])
        bottom = 1 - (top + self.down) / self.inside_height
        return [max(bottom, 0.0), 1 - top / self.inside_height]


DIGITS = 6
"""Significant digits of a value on a page: more than a screen shows, and a smaller file."""
DASHES = {"solid": "solid", "dashed": "dash", "dotted": "dot", "dashdot": "dashdot"}
CLEAR = "rgba(0,0,0,0)"
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


Parts = list[dict[str, Any]]


def _drawn(mark: Mark, panel: Panel, axes: dict[str, str]) -> tuple[Parts, Parts]:
    """Traces of a mark, without their axes, and shapes; a `name` stands in the legend.

    A stretch or a value of an axis is a shape, and has a trace for its legend only.
    """
    match mark:
        case Line():
            return _line(mark), []
        case Dots():
            marker = {"color": mark.color, "size": 1.5 * mark.size, "opacity": mark.opacity}
            return [_scatter(mark, "markers", marker=marker)], []
        case Span():
            shape = {"type": "rect", "layer": "below", "fillcolor": mark.color}
            shape |= {"line": {"width": 0}, "opacity": mark.opacity}
            key = {"color": mark.color, "opacity": mark.opacity, "symbol": "square", "size": 11}
            return _across(mark, (mark.low, mark.high), shape, axes, mode="markers", marker=key)
        case Level():
            style = {"color": mark.color, "dash": DASHES[mark.dashes], "width": 1}
            # Below, it would vanish under a line of the grid.
            shape = {"type": "line", "layer": "above", "line": style}
            return _across(mark, (mark.value, mark.value), shape, axes, mode="lines", line=style)
        case HeatMap():
            # A cell tells the names of its place, where the axes have some.
            x, y = plain_values(mark.x), plain_values(mark.y)
            stops = [[i / 10, color] for i, color in enumerate(RED_BLUE)]
            title = {"text": plain_text(mark.label), "side": "right"}
            trace: dict[str, Any] = {
                "type": "heatmap",
                "x": x,
                "y": y,
                "z": [plain_values(row) for row in np.asarray(mark.values)],
                "colorscale": stops,
                "zmin": mark.low,
                "zmax": mark.high,
                "hoverongaps": False,
                "hovertemplate": "%{x}, %{y}: %{z}<extra></extra>",
                "colorbar": {"title": title, "xpad": 8, "thickness": 12, "outlinewidth": 0},
            }
            if mark.numbers is not None:
                trace["texttemplate"] = f"%{{z:.{mark.numbers}f}}"
            if panel.x.categories or panel.y.categories:
                columns = [plain_text(name) for name in panel.x.categories] or x
                rows = [plain_text(name) for name in panel.y.categories] or y
                trace["customdata"] = [[[row, column] for column in columns] for row in rows]
                trace["hovertemplate"] = "%{customdata[0]}, %{customdata[1]}: %{z}<extra></extra>"
            return [trace], []


def _across(
    mark: Span | Level,
    ends: tuple[float, float],
    look: dict[str, Any],
    axes: dict[str, str],
    **key: Any,
) -> tuple[Parts, Parts]:
    """A stretch or a value of one axis, from end to end of the other, and an entry of the legend
    that points at nothing."""
    along, across = mark.axis, "y" if mark.axis == "x" else "x"
    start, stop = plain_values(ends)
    shape = look | {
        f"{along}ref": axes[f"{along}axis"],
        f"{across}ref": f"{axes[f'{across}axis']} domain",
        f"{along}0": start,
        f"{along}1": stop,
        f"{across}0": 0,
        f"{across}1": 1,
    }
    trace = {"type": "scatter", "x": [None], "y": [None], "hoverinfo": "skip", "name": mark.label}
    return [trace | key] if mark.label else [], [shape]


def _scatter(mark: Line | Dots, mode: str, **settings: Any) -> dict[str, Any]:
    x, y = plain_values(mark.x), plain_values(mark.y)
    return {"type": "scatter", "mode": mode, "x": x, "y": y, "name": mark.label, **settings}


def _line(line: Line) -> list[dict[str, Any]]:
    style = {"color": line.color, "dash": DASHES[line.dashes], "width": 1.2 * line.width}
    mode = "lines+markers" if line.markers else "lines"
    trace = _scatter(line, mode, line=style, marker={"size": 5})
    if line.error is not None:
        trace["error_y"] = {"array": plain_values(line.error), "thickness": 1, "width": 3}
    if line.low is None or line.high is None:
        return [trace]
    x, low, high = (np.asarray(values, float) for values in (line.x, line.low, line.high))
    trace["customdata"] = [plain_values(pair) for pair in np.column_stack((low, high))]
    trace["hovertemplate"] = "(%{x}, %{y})<br>%{customdata[0]} to %{customdata[1]}"
    # The band: one closed outline for each unbroken stretch.
    whole = np.flatnonzero(np.isfinite(x) & np.isfinite(low) & np.isfinite(high))
    around: list[np.ndarray] = []
    for part in np.split(whole, np.flatnonzero(np.diff(whole) > 1) + 1):
        there = np.column_stack((x[part], high[part]))
        back = np.column_stack((x[part], low[part]))[::-1]
        around += [there, back, np.full((1, 2), np.nan)]
    across, along = np.concatenate(around).T
    red, green, blue = (int(line.color[i : i + 2], 16) for i in (1, 3, 5))
    band = {
        "type": "scatter",
        "mode": "lines",
        "x": plain_values(across),
        "y": plain_values(along),
        "line": {"width": 0},
        "fill": "toself",
        "fillcolor": f"rgba({red},{green},{blue},0.18)",
        "hoverinfo": "skip",
        "showlegend": False,
        "legendgroup": plain_text(line.label) or None,
    }
    return [band, trace]


ABOVE = {"xanchor": "left", "yanchor": "bottom"}
"""Of what stands above a panel: which of its corners its place is that of."""
MARGIN = 0.04
"""Share of an axis between the data and an end that is not given."""
FEW_NUMBERS = 4
"""Numbers that a logarithmic axis aims at: 1, 2, 5 up to three decades, else powers of ten."""


def interactive(chart: Chart) -> dict[str, Any]:
    """Data and layout of a Plotly figure, ready for JSON."""
    spaces = Spaces.of(chart)
    above, right = spaces.above[0], RIGHT + spaces.right[-1]
    layout: dict[str, Any] = {
        "height": round(spaces.height),
        "margin": {"l": LEFT, "r": right, "t": above, "b": spaces.below[-1]},
        "font": {"family": "system-ui, sans-serif", "size": 12, "color": "#1a1a1a"},
        "paper_bgcolor": CLEAR,
        "plot_bgcolor": CLEAR,
        "separators": ".",
        "hovermode": "closest",
        "hoverlabel": {"namelength": -1},
        "shapes": [],
        "annotations": [],
    }
    data: list[dict[str, Any]] = []
    shared: dict[tuple[str, int], str] = {}
    for i, (row, place, panel) in enumerate(chart.places):
        number = str(i + 1) if i else ""
        axes = {"xaxis": f"x{number}", "yaxis": f"y{number}"}
        across, down = spaces.across(place, panel.columns), spaces.along(row)
        x = _axis(panel.x, panel.reach("x")) | {"domain": across, "anchor": axes["yaxis"]}
        y = _axis(panel.y, panel.reach("y")) | {"domain": down, "anchor": axes["xaxis"]}
        # An axis zooms with the first of its row or column; without a label it has no numbers.
        for drawn, wanted, which, line, is_shared in (
            (x, panel.x, "xaxis", place, chart.share_x),
            (y, panel.y, "yaxis", row, chart.share_y),
        ):
            if is_shared:
                first = shared.setdefault((which, line), axes[which])
                drawn |= {} if first == axes[which] else {"matches": first}
                drawn |= {} if wanted.label else {"showticklabels": False}
        layout |= {f"xaxis{number}": x, f"yaxis{number}": y}
        parts = [_drawn(mark, panel, axes) for mark in panel.marks]
        traces: Parts = [trace | axes for some, _ in parts for trace in some]
        layout["shapes"] += [shape for _, shapes in parts for shape in shapes]
        legend = "legend" if chart.legend else f"legend{number}"
        # A name stands in a legend once.
        shown, named = i == 0 or not chart.legend, set()
        for trace in traces:
            if "colorbar" in trace:
                middle, size = sum(down) / 2, down[1] - down[0]
                trace["colorbar"] |= {"x": across[1], "y": middle, "len": size}
            if "name" in trace:
                name = plain_text(trace["name"])
                trace |= {"name": name, "legendgroup": name or None, "legend": legend}
                trace["showlegend"] = shown and bool(name) and name not in named
                named.add(name)
        data += traces
        own_legend = bool(panel.labels) and not chart.legend
        if own_legend or (chart.legend and i == 0):
            shift = TITLE / spaces.inside_height if chart.legend and panel.title else 0
            layout[legend] = ABOVE | {
                "orientation": "h",
                "x": across[0],
                "y": down[1] + shift,
                "bgcolor": CLEAR,
                "tracegroupgap": 4,
            }
        if panel.title:
            title = ABOVE | {
                "text": f"<b>{plain_text(panel.title)}</b>",
                "x": across[0],
                "y": down[1],
                "yshift": LEGEND if own_legend else 2,
                "xref": "paper",
                "yref": "paper",
                "showarrow": False,
            }
            layout["annotations"].append(title)
    return {"data": data, "layout": layout}


def _axis(wanted: Axis, reach: tuple[float, float]) -> dict[str, Any]:
    """The axis, of which `reach` is drawn."""
    axis: dict[str, Any] = {
        "title": {"text": plain_text(wanted.label), "standoff": 6},
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
    if wanted.categories:
        names = [plain_text(name) for name in wanted.categories]
        axis |= {"tickvals": list(range(len(names))), "ticktext": names, "showgrid": False}
    if wanted.low is None and wanted.high is None:
        return axis | ({"autorange": "reversed"} if wanted.reverse else {})
    # Plotly finds both ends itself or neither.
    low, high = np.log10(reach) if wanted.log else reach
    margin = MARGIN * (high - low)
    ends = [low - margin * (wanted.low is None), high + margin * (wanted.high is None)]
    return axis | {"range": plain_values(ends[::-1] if wanted.reverse else ends)}
