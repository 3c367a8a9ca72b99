"""Charts on a page: a Plotly figure in plain data, which zooms and tells values on hover."""

from typing import Any

import numpy as np

from riecjax.reporting.charts.chart import PLAIN, Axis, Chart, Line
from riecjax.reporting.charts.layout import LEFT, LEGEND, RIGHT, TITLE, Spaces
from riecjax.reporting.charts.traces import CLEAR, DIGITS, plain_text, plain_values, shapes, traces

MARGIN = 0.04
"""Share of an axis between the data and an end that is not given."""
FEW_NUMBERS = 4
"""Numbers that a logarithmic axis aims at: 1, 2, 5 up to three decades, else powers of ten."""
RIGHT_AXES = 101
"""Number of the first panel's right axis: past those of all panels' left ones."""


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
        if chart.share_x:
            x |= _sharing(panel.x, shared.setdefault(("x", place), axes["xaxis"]), axes["xaxis"])
        if chart.share_y:
            y |= _sharing(panel.y, shared.setdefault(("y", row), axes["yaxis"]), axes["yaxis"])
        layout |= {f"xaxis{number}": x, f"yaxis{number}": y}
        right_axis = axes | {"yaxis": f"y{RIGHT_AXES + i}"}
        if panel.right is not None:
            over = {"overlaying": axes["yaxis"], "side": "right", "anchor": axes["xaxis"]}
            over |= {"showgrid": False, "tickmode": "auto"}
            layout[f"yaxis{RIGHT_AXES + i}"] = _axis(panel.right, panel.reach("right")) | over
        drawn = []
        for mark in panel.marks:
            on_right = isinstance(mark, Line) and mark.right
            drawn += [trace | (right_axis if on_right else axes) for trace in traces(mark, panel)]
            layout["shapes"] += shapes(mark, axes)
        for trace in drawn:
            if "colorbar" in trace:
                bar = {"x": across[1], "y": sum(down) / 2, "len": down[1] - down[0]}
                trace["colorbar"] = trace["colorbar"] | bar
        legend = "legend" if chart.legend else f"legend{number}"
        _name(drawn, legend, shown=panel.legend and (i == 0 or not chart.legend))
        data += drawn
        own_legend = bool(panel.labels) and not chart.legend
        if own_legend or (chart.legend and i == 0):
            shift = TITLE / spaces.inside_height if chart.legend and panel.title else 0
            layout[legend] = _legend(across[0], down[1] + shift)
        if panel.title:
            height = LEGEND if own_legend else 2
            layout["annotations"].append(_title(panel.title, across[0], down[1], height))
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
    if wanted.color:
        axis |= {"color": wanted.color}
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


def _sharing(wanted: Axis, first: str, own: str) -> dict[str, Any]:
    """Let an axis zoom with the `first` of its row or column; without a label it has no numbers."""
    zoom = {} if first == own else {"matches": first}
    return zoom if wanted.label else zoom | {"showticklabels": False}


def _name(drawn: list[dict[str, Any]], legend: str, *, shown: bool) -> None:
    """Say of a panel's traces where they are named; a name stands in a legend once."""
    named = set()
    for trace in drawn:
        if "name" in trace:
            name = plain_text(trace["name"])
            first = shown and bool(name) and name not in named
            named.add(name)
            trace |= {"name": name, "legendgroup": name or None}
            trace |= {"showlegend": first, "legend": legend}


def _legend(x: float, y: float) -> dict[str, Any]:
    place = {"orientation": "h", "x": x, "y": y, "xanchor": "left", "yanchor": "bottom"}
    return place | {"bgcolor": CLEAR, "tracegroupgap": 4}


def _title(text: str, x: float, y: float, shift: float) -> dict[str, Any]:
    place = {"x": x, "y": y, "yshift": shift, "xref": "paper", "yref": "paper"}
    look = {"xanchor": "left", "yanchor": "bottom", "showarrow": False}
    return {"text": f"<b>{plain_text(text)}</b>", **place, **look}
