"""Figures of a fleet: each parameter over its groups, and over time."""

from collections.abc import Sequence

import numpy as np

from riecjax.fleets.fleet import Fleet
from riecjax.fleets.groups import Entry
from riecjax.fleets.spread import Spread
from riecjax.fleets.sums import DONE
from riecjax.reporting.charts.chart import (
    BLUE,
    GREY,
    RUST,
    SERIES,
    Axis,
    Chart,
    Dots,
    Level,
    Line,
    Panel,
    in_rows,
    labelled,
)

COLUMNS = 2
COURSES = 4
"""Recordings whose courses are drawn: those that change first."""


def fleet_figures(found: Fleet) -> dict[str, Chart]:
    """`groups`, if there are enough to compare, and `courses` over time, if there are some."""
    figures = {}
    if found.spreads:
        panels = [_over_groups(one, found.entries) for one in found.spreads]
        figures["groups"] = _chart(
            panels,
            "Values of all groups in the order of their size, with 95 % intervals. Groups that "
            "differ from the rest, and not by chance, stand out; the line is what most have.",
        )
    if courses := _courses(found):
        figures["courses"] = _chart(
            courses,
            "Estimates from spans of time, with their standard errors; vertical lines are steps "
            "that chance does not explain.",
        )
    return figures


def _chart(panels: Sequence[Panel], caption: str) -> Chart:
    rows = in_rows(panels, COLUMNS)
    return Chart(rows, caption, size=(8.0, 1.0 + 2.4 * len(rows)), legend=True)


def _over_groups(one: Spread, entries: Sequence[Entry]) -> Panel:
    some = [
        e
        for e in entries
        if e.parameter == one.parameter and e.status == DONE and e.verdict != "do not use"
    ]
    ordered = sorted(some, key=lambda e: e.value or 0.0)
    values, low, high = (
        np.array([getattr(e, name) for e in ordered], float)
        for name in ("value", "low95", "high95")
    )
    rank = np.arange(1, len(ordered) + 1)
    standing = {group.group for group in one.differing}
    out = np.array([e.group in standing for e in ordered], bool)
    marks = [
        Line(rank, values, "groups", BLUE, width=1.0, markers=len(rank) <= 60, low=low, high=high),
        Level(one.centre, label="what most have", color=GREY, dashes="dashed"),
        Dots(rank[out], values[out], "differ from the rest", RUST, size=5),
    ]
    return Panel(marks, Axis("group, by size"), Axis(labelled(one.parameter, one.unit)))


def _courses(found: Fleet) -> list[Panel]:
    if not found.over_time:
        return []
    stepping = list(dict.fromkeys(change.group for change in found.changes))
    names = list(dict.fromkeys((*stepping, *(entry.group for entry in found.over_time))))[:COURSES]
    parameters = list(dict.fromkeys(e.parameter for e in found.over_time if e.parameter))
    return [_course(found, name, names) for name in parameters]


def _course(found: Fleet, parameter: str, names: Sequence[str]) -> Panel:
    marks, unit = [], ""
    for name, color in zip(names, SERIES):
        some = [e for e in found.over_time if (e.group, e.parameter) == (name, parameter)]
        unit = next((e.unit for e in some if e.unit), unit)
        middle = [0.5 * (e.start + e.end) for e in some]
        values = np.array([e.value for e in some], float)
        errors = np.array([e.std_error for e in some], float)
        marks.append(Line(middle, values, name, color, markers=True, width=1.0, error=errors))
        marks += [
            Level(change.time, "x", color=color)
            for change in found.changes
            if (change.group, change.parameter) == (name, parameter)
        ]
    return Panel(marks, Axis("time / s"), Axis(labelled(parameter, unit)))
