"""When a parameter changed: steps of its course over spans of time."""

# Values of spans, each with its error s, are constant but for steps. In units of their errors that
# is a regression of theta / s on 1 / s with a coefficient that jumps; where it does is found by
# PELT (Killick, Fearnhead and Eckley 2012). A step must take more off the sum of squares than
# the best of n places does by chance in all but `ALARMS` of courses without one.

import warnings
from collections.abc import Iterable
from typing import NamedTuple

import numpy as np
import scipy.stats

from riecjax.fleets.groups import Entry, errors_of, has_error

ALARMS = 0.01
"""Share of courses without a step that one is found in."""
FEWEST = 4
"""Spans of a course, two on either side of a step."""


class Change(NamedTuple):
    """A step: of which group and parameter, at which time in seconds, from which value to which."""

    group: str
    parameter: str
    unit: str
    time: float
    before: float
    after: float


def changes(entries: Iterable[Entry]) -> list[Change]:
    """Steps of all courses, by group and parameter."""
    courses: dict[tuple[str, str], list[Entry]] = {}
    for entry in entries:
        if entry.parameter is not None and has_error(entry):
            courses.setdefault((entry.group, entry.parameter), []).append(entry)
    return [step for course in courses.values() for step in _steps(course)]


def _steps(course: list[Entry]) -> list[Change]:
    if len(course) < FEWEST:
        return []
    ordered = sorted(course, key=lambda entry: entry.start)
    values = np.array([entry.value for entry in ordered], float)
    errors = errors_of(ordered)
    import ruptures

    # Values are taken from their mean: of what they have in common no digit is lost.
    shifted = values - values.mean()
    signal = np.column_stack([shifted / errors, 1 / errors])
    penalty = scipy.stats.chi2.isf(ALARMS / len(ordered), 1)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        ends = ruptures.Pelt(model="linear", min_size=2, jump=1).fit(signal).predict(penalty)
    levels = [
        float(np.average(values[a:b], weights=errors[a:b] ** -2))
        for a, b in zip([0, *ends[:-1]], ends)
    ]
    first = ordered[0]
    return [
        Change(
            first.group, first.parameter or "", first.unit or "", ordered[end].start, before, after
        )
        for end, before, after in zip(ends[:-1], levels, levels[1:])
    ]
