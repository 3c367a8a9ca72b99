"""Axes and places of panels, as a page draws them."""

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
    Line,
    Panel,
    Stems,
    as_array,
)

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


PIXELS = 88
"""To an inch of the printed figure, in height; the width is the page's."""
NARROWEST_PANEL = 210
"""Width in pixels of a panel without its numbers and labels, below which a page scrolls."""
WIDEST_LEGEND = 380
LEFT, RIGHT, BOTTOM, BARE_BOTTOM = 62, 14, 46, 12
"""Pixels about a panel: numbers and label of its axes, or ticks alone."""
RIGHT_AXIS, COLOUR_BAR = 56, 78
TITLE, LEGEND = 20, 26
LETTER, KEY = 6.2, 40
"""Pixels of a letter, and of a sign with its gaps, in a legend."""


def narrowest(chart: Chart) -> int:
    """Width in pixels below which a chart should be scrolled, not squashed."""
    return round(Spaces.of(chart).width)


def places(chart: Chart) -> Iterator[tuple[int, int, Panel]]:
    """Each panel with its row and its first column."""
    for i, row in enumerate(chart.rows):
        place = 0
        for panel in row:
            if panel is not None:
                yield i, place, panel
            place += 1 if panel is None else panel.columns


class Spaces(NamedTuple):
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
    def of(cls, chart: Chart) -> "Spaces":
        """Of a chart, with room for all its numbers, titles and legends."""
        rows = len(chart.rows)
        panel = float(NARROWEST_PANEL)
        right, above, below = [0] * chart.columns, [6] * rows, [BARE_BOTTOM] * rows
        for row, place, one in places(chart):
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
    own = not chart.legend and has_legend(panel)
    return 6 + TITLE * bool(panel.title) + LEGEND * own


def has_legend(panel: Panel) -> bool:
    """Whether a panel has anything to explain."""
    return panel.legend and bool(_labels(panel))


def _labels(panel: Panel) -> set[str]:
    named = (mark for mark in panel.marks if not isinstance(mark, HeatMap))
    return {mark.label for mark in named} - {""}


def _legend_width(panel: Panel) -> float:
    return sum(LETTER * len(label) + KEY for label in _labels(panel)) if panel.legend else 0.0
