"""Axes, numbers and texts as Plotly takes them."""

import html
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike

from riecjax.reporting.charts.chart import PLAIN, Axis, Dots, Line, Panel, Stems, as_array

DIGITS = 6
"""Significant digits of a value on a page: more than a screen shows, and a smaller file."""
MARGIN = 0.04
"""Share of an axis between the data and an end that is not given."""
FEW_NUMBERS = 4
"""Numbers that a logarithmic axis aims at: 1, 2, 5 up to three decades, else powers of ten."""


def plotly_axis(wanted: Axis, reach: tuple[float, float]) -> dict[str, Any]:
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
        axis |= {
            "tickvals": list(range(len(wanted.categories))),
            "ticktext": [plain_text(name) for name in wanted.categories],
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
    return {"range": plain_values([high, low] if wanted.reverse else [low, high])}


def share_axis(axis: dict[str, Any], wanted: Axis, first: str, own: str) -> None:
    """Let an axis zoom with the `first` of its row or column; without a label it has no numbers."""
    if first != own:
        axis["matches"] = first
    if not wanted.label:
        axis["showticklabels"] = False


def reach_of(panel: Panel, which: Literal["x", "y", "right"]) -> tuple[float, float]:
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


def plain_values(values: ArrayLike) -> list[Any]:
    """Numbers for JSON, in one list."""
    return [plain_number(value) for value in as_array(values).ravel().tolist()]


def plain_number(value: float) -> float | None:
    """Rounded for the page; a gap where there is no number."""
    return float(f"{value:.{DIGITS}g}") if np.isfinite(value) else None


def plain_text(text: str) -> str:
    """Plotly reads a little HTML in texts."""
    return html.escape(text, quote=False)
