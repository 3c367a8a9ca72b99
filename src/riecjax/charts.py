"""What a figure shows, in plain data.

A chart says what is drawn and what it means, not how: one description is printed by matplotlib and
drawn on a page by Plotly, so that the two never differ.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

BLUE, RUST, GREY, BLACK = "#1f4e79", "#b0532b", "#9a9a9a", "#1a1a1a"
"""What a model says; what it leaves, or a second series; what was measured; a reference."""
TEAL, OCHRE = "#4c9a92", "#c9982f"
"""Third and fourth series. All differ in lightness too, and in print without colour by dashes."""
SERIES = (BLUE, RUST, TEAL, OCHRE)
"""Colours of four series, with [`DASHES`][]."""
PALE = "#dbdbdb"
"""Stretches within which nothing is remarkable."""

PLAIN = (1e-3, 1e5)
"""Numbers on a logarithmic axis between these are written out, others as powers of ten."""

THIN, USUAL, BOLD, WIDE = 0.9, 1.3, 1.8, 4.0
"""Points across a line of samples, a curve, the main curve, and what lies behind others."""
SMALL, LARGE = 1.5, 5.0
"""Sizes of dots in points, of which there are thousands or a few."""
PANEL = (3.4, 2.4)
"""Inches across and down that a panel takes in print, with its labels."""
LOW = 1.6
"""Inches down of a panel that shares its axis of time with those beneath."""
CATEGORY = 0.4
"""Inches of a place that has a name."""
NARROWEST, AROUND = 7.5, 0.8
"""Inches across of a figure at the least, and about all panels of one."""

Dashes = Literal["solid", "dashed", "dotted", "dashdot"]
DASHES: tuple[Dashes, ...] = ("solid", "dashed", "dotted", "dashdot")


@dataclass(frozen=True)
class Axis:
    """An axis: its label with the unit, and where it ends (`None`: where the data do).

    **Fields:** `log` for a logarithmic axis; `categories`, names of the places 0, 1, ...;
    `reverse`, values grow downwards (to the left).
    """

    label: str = ""
    log: bool = False
    low: float | None = None
    high: float | None = None
    categories: tuple[str, ...] = ()
    reverse: bool = False


@dataclass(frozen=True)
class Line:
    """Values over x; NaN leaves a gap.

    **Fields:** `low` and `high`, a band about it; `error`, bars of plus and minus so much;
    `markers` at the values.
    """

    x: ArrayLike
    y: ArrayLike
    label: str = ""
    color: str = BLUE
    dashes: Dashes = "solid"
    width: float = USUAL
    markers: bool = False
    low: ArrayLike | None = None
    high: ArrayLike | None = None
    error: ArrayLike | None = None


@dataclass(frozen=True)
class Dots:
    """Single values."""

    x: ArrayLike
    y: ArrayLike
    label: str = ""
    color: str = BLUE
    size: float = 3.0
    opacity: float = 1.0


@dataclass(frozen=True)
class Span:
    """A stretch of an axis."""

    low: float
    high: float
    axis: Literal["x", "y"] = "x"
    label: str = ""
    color: str = PALE
    opacity: float = 1.0


@dataclass(frozen=True)
class Level:
    """One value of an axis, across the panel."""

    value: float = 0.0
    axis: Literal["x", "y"] = "y"
    label: str = ""
    color: str = GREY
    dashes: Dashes = "solid"


@dataclass(frozen=True)
class HeatMap:
    """Values about zero over a grid, shape `(y, x)`, with their `label`.

    **Fields:** `low` and `high`, ends of the scale; `numbers`, decimals of the values written into
    the cells, `None` for none.
    """

    x: ArrayLike
    y: ArrayLike
    values: ArrayLike
    label: str
    low: float
    high: float
    numbers: int | None = None


Mark = Line | Dots | Span | Level | HeatMap


@dataclass(frozen=True)
class Panel:
    """One pair of axes; `columns`, how many places of its row it takes.

    A legend stands above it, under its `title`.
    """

    marks: Sequence[Mark]
    x: Axis = field(default_factory=Axis)
    y: Axis = field(default_factory=Axis)
    title: str = ""
    columns: int = 1

    @property
    def labels(self) -> set[str]:
        """What its legend explains; a map has a colour bar instead."""
        return {mark.label for mark in self.marks if not isinstance(mark, HeatMap)} - {""}

    def reach(self, which: Literal["x", "y"]) -> tuple[float, float]:
        """Ends of an axis: those given, or least and largest value; 0 and 1 where there is none."""
        axis = self.x if which == "x" else self.y
        drawn = [getattr(mark, which) for mark in self.marks if isinstance(mark, Line | Dots)]
        values = np.concatenate([[], *map(np.ravel, drawn)])
        finite = values[np.isfinite(values)]
        least, most = (float(finite.min()), float(finite.max())) if finite.size else (0.0, 1.0)
        return least if axis.low is None else axis.low, most if axis.high is None else axis.high


@dataclass(frozen=True)
class Chart:
    """A figure: rows of panels, `None` for an empty place.

    **Fields:**

    - `caption`: what it shows and how to read it, a sentence or two.
    - `share_x`: panels above one another zoom together, and only those whose x axis has a label
      have numbers on it. `share_y`: the same for those of a row.
    - `legend`: of the first panel, once for all, above them.
    """

    rows: Sequence[Sequence[Panel | None]]
    caption: str = ""
    share_x: bool = False
    share_y: bool = False
    legend: bool = False

    @property
    def size(self) -> tuple[float, float]:
        """Inches of the printed figure, as its panels need."""
        across, down = PANEL[0], [LOW if self.share_x else PANEL[1]] * len(self.rows)
        for row, _, panel in self.places:
            across = max(across, CATEGORY * len(panel.x.categories))
            down[row] = max(down[row], CATEGORY * len(panel.y.categories))
        return max(across * self.columns, NARROWEST) + AROUND, sum(down) + AROUND

    @property
    def columns(self) -> int:
        """Places in a row."""
        return max(sum(1 if p is None else p.columns for p in row) for row in self.rows)

    @property
    def places(self) -> Iterator[tuple[int, int, Panel]]:
        """Each panel, with its row and its first column."""
        for i, row in enumerate(self.rows):
            place = 0
            for panel in row:
                if panel is not None:
                    yield i, place, panel
                place += 1 if panel is None else panel.columns

    @property
    def panels(self) -> list[Panel]:
        """All panels, row by row."""
        return [panel for _, _, panel in self.places]


def single(marks: Sequence[Mark], x: Axis, y: Axis, caption: str = "") -> Chart:
    """A chart of one panel."""
    return Chart(((Panel(marks, x, y),),), caption)


def in_rows(panels: Sequence[Panel]) -> list[list[Panel | None]]:
    """Panels two in a row, the last row filled up with an empty place."""
    columns = min(len(panels), 2)
    places: list[Panel | None] = [*panels, *[None] * (-len(panels) % columns)]
    return [places[i : i + columns] for i in range(0, len(places), columns)]


def labelled(what: str, unit: str | None) -> str:
    """An axis label with its unit, if there is one."""
    return f"{what} / ({unit})" if unit else what
