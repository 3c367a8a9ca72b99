"""How a parameter is spread over groups: how much is chance, and who differs from the rest."""

import warnings
from collections.abc import Iterable, Sequence
from typing import Any, NamedTuple

import numpy as np
import scipy.optimize
import scipy.stats
from jaxtyping import Float

from riecjax.fleets.groups import Entry
from riecjax.fleets.order import DONE

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
    return known and _values_of([entry])[1][0] > 0


def _values_of(entries: Sequence[Entry]) -> Float[np.ndarray, "2 n"]:
    """Values, and standard errors of normal laws whose intervals are as wide: with few blocks of
    time an interval is wider than its standard error tells."""
    values, low, high = np.array([(e.value, e.low95, e.high95) for e in entries], float).T
    return np.stack([values, (high - low) / (2 * scipy.stats.norm.isf(0.025))])


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


def spreads(entries: Iterable[Entry]) -> list[Spread]:
    """Of each parameter that enough groups have a value of that is not ruled out; false discoveries
    are counted over all parameters together."""
    from statsmodels.stats.meta_analysis import combine_effects

    by_name: dict[str, list[Entry]] = {}
    for entry in entries:
        if entry.parameter and entry.verdict != "do not use" and has_error(entry):
            by_name.setdefault(entry.parameter, []).append(entry)
    compared = [every for every in by_name.values() if len(every) >= FEWEST]
    if not compared:
        return []
    centres, p_values = zip(*(_judged(*_values_of(every)) for every in compared))
    adjusted = scipy.stats.false_discovery_control(np.concatenate(p_values))
    found = []
    for every, centre, chances in zip(compared, centres, p_values):
        (values, errors), first = _values_of(every), every[0]
        # Where all are equal, shares of no variance are asked for.
        with np.errstate(divide="ignore", invalid="ignore"):
            effects: Any = combine_effects(values, errors**2, method_re="iterated")
        own, adjusted = adjusted[: len(every)], adjusted[len(every) :]
        differing = [
            Differing(entry.group, value, value / centre - 1, p, q)
            for entry, value, p, q in zip(every, values, chances, own)
            if q <= RATE
        ]
        found.append(
            Spread(
                parameter=first.parameter or "",
                unit=first.unit or "",
                groups=len(every),
                mean=float(effects.mean_effect_re),
                std_error=float(effects.sd_eff_w_re),
                between=float(np.sqrt(max(effects.tau2, 0.0))),
                within=float(np.median(errors)),
                share=float(max(effects.i2, 0.0)),
                p_value=float(effects.test_homogeneity().pvalue),
                centre=centre,
                differing=tuple(sorted(differing, key=lambda group: group.p_value)),
            )
        )
    return found


def _judged(
    values: Float[np.ndarray, " n"], errors: Float[np.ndarray, " n"]
) -> tuple[float, Float[np.ndarray, " n"]]:
    """Centre of most groups, and the probability of each group's distance by chance."""
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
    import ruptures

    courses: dict[tuple[str, str], list[Entry]] = {}
    for entry in entries:
        if entry.parameter is not None and has_error(entry):
            courses.setdefault((entry.group, entry.parameter), []).append(entry)
    steps = []
    for (group, parameter), course in courses.items():
        if len(course) < FEWEST:
            continue
        course.sort(key=lambda entry: entry.start)
        values, errors = _values_of(course)
        # Values are taken from their mean: of what they have in common no digit is lost.
        signal = np.column_stack([(values - values.mean()) / errors, 1 / errors])
        penalty = scipy.stats.chi2.isf(ALARMS / len(course), 1)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            ends = ruptures.Pelt(model="linear", min_size=2, jump=1).fit(signal).predict(penalty)
        levels = [
            float(np.average(values[a:b], weights=errors[a:b] ** -2))
            for a, b in zip([0, *ends[:-1]], ends)
        ]
        unit = course[0].unit or ""
        times = [course[end].start for end in ends[:-1]]
        steps += [Change(group, parameter, unit, *step) for step in zip(times, levels, levels[1:])]
    return steps
