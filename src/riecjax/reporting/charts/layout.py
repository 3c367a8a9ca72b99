"""Where a page puts the panels of a chart: pixels for numbers, titles and legends about each."""

from typing import NamedTuple

import numpy as np

from riecjax.reporting.charts.chart import Chart, HeatMap, Panel

PIXELS = 88
"""To an inch of the printed figure, in height; the width is the page's."""
NARROWEST_PANEL = 210
"""Width in pixels of a panel without its numbers and labels, below which a page scrolls."""
WIDEST_LEGEND = 380
LEFT, RIGHT, BOTTOM, BARE_BOTTOM = 62, 14, 46, 12
"""Pixels about a panel: numbers and label of its axes, or ticks alone."""
RIGHT_AXIS, COLOUR_BAR = 56, 78
GAP, TITLE, LEGEND = 6, 20, 26
"""Pixels above a panel."""
LETTER, KEY = 6.2, 40
"""Pixels of a letter, and of a sign with its gaps, in a legend."""
LOWEST_ROW = 110.0


class Spaces(NamedTuple):
    """Pixels across at the narrowest, and down.

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
        width = float(NARROWEST_PANEL)
        right, above, below = [0] * chart.columns, [GAP] * rows, [BARE_BOTTOM] * rows
        for row, place, panel in chart.places:
            last = place + panel.columns - 1
            right[last] = max(right[last], _right_of(panel))
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
        heights = np.array(chart.heights or (1.0,) * rows)
        room = max(PIXELS * chart.size[1] - sum(above) - sum(below), LOWEST_ROW * rows)
        return cls(width, right, above, below, (room * heights / heights.sum()).tolist())

    @property
    def width(self) -> float:
        """Of everything: below it, a chart should be scrolled, not squashed."""
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
