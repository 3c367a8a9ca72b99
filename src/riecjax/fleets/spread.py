"""How a parameter is spread over groups: how much is chance, and who differs from the rest."""

import warnings
from collections.abc import Iterable, Sequence
from typing import Any, NamedTuple

import numpy as np
import scipy.optimize
import scipy.stats
from jaxtyping import Float

from riecjax.fleets.groups import Entry
from riecjax.fleets.sums import DONE

# Two questions, and two answers. How far do groups differ at all: an estimate is the groups' mean,
# plus a deviation of the group with variance tau^2, plus the error of its own; tau^2 by Paule and
# Mandel's moments, as random-effects models of meta-analysis have it. And which groups stand out
# of the others: for that the centre and the spread must not be made by those who do. So the centre
# is a weighted median, and tau the one with which half of all groups lie within the quartiles of
# a normal law. One p-value for each group and parameter; of those that are called different so
# many are wrong, on average, as the rate says (Benjamini and Hochberg 1995).


FEWEST = 4
"""Groups below which there is no rest to differ from; spans of a course, two on either side of a
step."""
RATE = 0.05
"""False discoveries, as a share of all groups that are called different."""


def has_error(entry: Entry) -> bool:
    """Whether an entry has a value with an interval of some width, to be held against others."""
    ends = entry.low95, entry.value, entry.high95
    known = entry.status == DONE and all(end is not None and np.isfinite(end) for end in ends)
    return known and errors_of([entry])[0] > 0


def errors_of(entries: Sequence[Entry]) -> Float[np.ndarray, " n"]:
    """Standard errors of normal laws whose intervals are as wide as these entries': with few blocks
    of time an interval is wider than its standard error tells."""
    widths = np.array([(entry.high95 or 0.0) - (entry.low95 or 0.0) for entry in entries], float)
    return widths / (2 * scipy.stats.norm.isf(0.025))


class Differing(NamedTuple):
    """A group that differs from the rest: its value, by what share of the centre it is away, and
    the probability of so much by chance, which is to be held against the rate by `adjusted`."""

    group: str
    value: float
    away: float
    p_value: float
    adjusted: float


class Spread(NamedTuple):
    """One parameter over groups.

    **Fields:** `mean` over groups and its `std_error`, of a random-effects model; `between`,
    standard deviation of groups beyond chance; `within`, the median of their standard errors;
    `share` of the variance that is between groups (I^2); `p_value` of so much spread by chance;
    `centre` of most groups, which `differing` ones are away from.
    """

    parameter: str
    unit: str
    groups: int
    mean: float
    std_error: float
    between: float
    within: float
    share: float
    p_value: float
    centre: float
    differing: tuple[Differing, ...]


def spreads(entries: Iterable[Entry], rate: float = RATE) -> list[Spread]:
    """Of each parameter that enough groups have a value of that is not ruled out.

    **Arguments:** `rate` of false discoveries among groups that are called different, over all
    parameters together.
    """
    by_name: dict[str, list[Entry]] = {}
    for entry in entries:
        if entry.parameter and entry.verdict != "do not use" and has_error(entry):
            by_name.setdefault(entry.parameter, []).append(entry)
    some = {name: every for name, every in by_name.items() if len(every) >= FEWEST}
    judged = {name: _judged(every) for name, every in some.items()}
    if not judged:
        return []
    adjusted = iter(
        scipy.stats.false_discovery_control(np.concatenate([p for _, p in judged.values()]))
    )
    return [
        _spread(every, judged[name], [next(adjusted) for _ in every], rate)
        for name, every in some.items()
    ]


def _judged(every: Sequence[Entry]) -> tuple[float, Float[np.ndarray, " n"]]:
    """Centre of most groups, and the probability of each group's distance by chance."""
    values, errors = np.array([entry.value for entry in every], float), errors_of(every)
    half = scipy.stats.chi2.median(1)

    ranked = np.argsort(values)

    def centre(between: float) -> float:
        """The weighted median, between two values where half of the weight lies on either side."""
        weights = 1 / (errors[ranked] ** 2 + between)
        sums = np.cumsum(weights) - 0.5 * weights
        return float(np.interp(0.5 * np.sum(weights), sums, values[ranked]))

    def excess(between: float) -> float:
        squares = (values - centre(between)) ** 2 / (errors**2 + between)
        return float(np.median(squares)) - half

    most = float(np.ptp(values)) ** 2 / half
    between = 0.0
    if excess(0.0) > 0 and most > 0:
        root = scipy.optimize.root_scalar(excess, bracket=(0.0, 4 * most), xtol=1e-12 * most)
        between = float(root.root)
    total = errors**2 + between
    # A median is pi / 2 times as uncertain as a mean.
    of_centre = 0.5 * np.pi / np.sum(1 / total)
    away = np.abs(values - centre(between)) / np.sqrt(total + of_centre)
    return centre(between), 2 * scipy.stats.norm.sf(away)


def _spread(
    every: Sequence[Entry],
    judged: tuple[float, Float[np.ndarray, " n"]],
    adjusted: Sequence[float],
    rate: float,
) -> Spread:
    from statsmodels.stats.meta_analysis import combine_effects

    values, errors = np.array([entry.value for entry in every], float), errors_of(every)
    # Where all are equal, shares of no variance are asked for.
    with np.errstate(divide="ignore", invalid="ignore"):
        found: Any = combine_effects(values, errors**2, method_re="iterated")
    centre, p_values = judged
    differing = [
        Differing(entry.group, value, value / centre - 1, p, q)
        for entry, value, p, q in zip(every, values, p_values, adjusted)
        if q <= rate
    ]
    first = every[0]
    return Spread(
        first.parameter or "",
        first.unit or "",
        len(every),
        float(found.mean_effect_re),
        float(found.sd_eff_w_re),
        float(np.sqrt(max(found.tau2, 0.0))),
        float(np.median(errors)),
        float(max(found.i2, 0.0)),
        float(found.test_homogeneity().pvalue),
        centre,
        tuple(sorted(differing, key=lambda one: one.p_value)),
    )


# Values of spans, each with its error s, are constant but for steps. In units of their errors that
# is a regression of theta / s on 1 / s with a coefficient that jumps; where it does is found by
# PELT (Killick, Fearnhead and Eckley 2012). A step must take more off the sum of squares than
# the best of n places does by chance in all but `ALARMS` of courses without one.


ALARMS = 0.01
"""Share of courses without a step that one is found in."""


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
