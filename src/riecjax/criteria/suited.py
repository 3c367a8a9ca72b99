"""Which criterion, and which of two sensors, suits a model and what was recorded of its motion.

The boxcar of RIEC as published needs a recorded velocity for every inertia. Where the record has
none, or one that was made of the position, noise and all, a smooth test function takes both
derivatives off the position instead, and the velocity appears in no window.
"""

import dataclasses
import functools
from collections.abc import Sequence
from typing import Any

import numpy as np

from riecjax import arrays as xp
from riecjax.criteria.criterion import DOLS, RIEC, AbstractCriterion
from riecjax.criteria.test_functions import TEST_FUNCTIONS, AbstractTestFunction, Bump, GradedBump
from riecjax.criteria.windows import DEFAULT_BAND, AllWindows, RandomWindows
from riecjax.equations.equation import Equation
from riecjax.equations.model import Model
from riecjax.equations.term import AbstractTerm
from riecjax.errors import MissingSignalError, require
from riecjax.records.preparation.filtering import local_slope
from riecjax.records.record import Record
from riecjax.settings import Contradiction, Fit

LENGTHS = 8
"""Of bumps, evenly spaced: their rows change slowly with the length."""
LONGEST = 0.2
"""Share of a record that a bump lasts at most."""
PERIODS = 1.3
"""Periods of a mode that a bump lasts in which it shows best."""
FASTER = 5
"""Times the band's highest frequency that modes are looked for up to."""
RATIO = 2**0.5
"""Of neighbouring lengths of bumps where modes are hidden."""
MOST = 2
"""Time derivatives that a test function takes off at most."""


def criterion_for(
    fit: Fit | AbstractCriterion | None, model: Model, records: Sequence[Record]
) -> AbstractCriterion:
    """The criterion that settings ask for; the one that is [`suited`][] if they ask for none.

    **Arguments:** `fit`, settings, whose `band` replaces the model's, or already a criterion.

    **Raises:** `ModelError` for what is no criterion; `Contradiction` for a quadrature where the
    test function has none.
    """
    asked = fit.criterion if isinstance(fit, Fit) else fit
    kinds = AbstractCriterion | str | None if isinstance(fit, Fit) else AbstractCriterion | None
    write = (
        "rx.RIEC(rx.AllWindows(0.05, 0.5)), with the shortest and the longest window in seconds, "
        "or rx.DOLS()"
    )
    require("the criterion", asked, kinds, write)
    if isinstance(asked, AbstractCriterion):
        return asked
    if asked == "dols":
        return DOLS()
    if not isinstance(fit, Fit) or not fit.says_of_windows:
        return suited(model, model.band, records)
    band = fit.band or model.band or DEFAULT_BAND
    # Bumps have no quadrature: to ask for one is to ask for boxcars.
    if fit.test_function in (None, "auto") and fit.quadrature is None:
        criterion = suited(model, band, records)
    else:
        criterion = RIEC.of_band(band, _test_function(fit))
    own: Any = criterion.windows
    alpha = own.alpha if fit.alpha is None else fit.alpha
    beta = own.beta if fit.beta is None else fit.beta
    if fit.windows is not None and not isinstance(fit.windows, str):
        windows = RandomWindows(alpha, beta, int(fit.windows))
        return RIEC(windows, criterion.test_function, criterion.why)
    return criterion.between(alpha, beta)


def _test_function(fit: Fit) -> AbstractTestFunction:
    named = {name: kind() for name, kind in TEST_FUNCTIONS.items()}
    weight = fit.test_function
    if not isinstance(weight, AbstractTestFunction):
        name = "boxcar" if weight in (None, "auto") else weight
        if name not in named:
            require("test_function", name, (), f"rx.Hat(), or one of {', '.join(named)}")
        weight = named[name]
    if fit.quadrature is None:
        return weight
    if not hasattr(weight, "quadrature"):
        having = [f"the {name}" for name, one in named.items() if hasattr(one, "quadrature")]
        raise Contradiction(f"{{quadrature}} belongs to {' and '.join(having)}.", fit.options())
    return dataclasses.replace(weight, quadrature=int(fit.quadrature))


def suited(model: Model, band: tuple[float, float] | None, records: Sequence[Record]) -> RIEC:
    """The criterion to take unless another is asked for, which says why if it has no boxcars.

    **Arguments:** `band` in hertz that the model should explain, 1 to 10 if there is none.
    """
    band = band or DEFAULT_BAND
    if any(element.order for element in model.hidden):
        return _with_elements(model, band, records)
    usual = RIEC.of_band(band)
    # Derivatives that boxcars would read of linear terms, and that no sensor measured.
    terms = (t for e in model.equations for t in e.terms if t.is_linear and t.derivative == 2)
    named = [(t.of, t.measured[0] if t.measured else "a velocity") for t in terms]
    lacking = [
        name
        for of, name in named
        for record in records
        if name not in record.arrays or (isinstance(of, str) and record.noise.is_made_of(name, of))
    ]
    if not lacking:
        return usual
    bump = RIEC.of_band(band, Bump(lengths=LENGTHS))
    alpha, beta = bump.windows.alpha, bump.windows.beta
    steps = [record.time_step for record in records]
    shortest = bump.test_function.fewest_samples * functools.reduce(xp.maximum, steps)
    longest = functools.reduce(xp.minimum, [LONGEST * record.duration for record in records])
    beta = xp.maximum(xp.minimum(beta, longest), 2 * shortest)
    alpha = xp.maximum(xp.minimum(alpha, 0.5 * beta), shortest)
    why = f"no sensor measured {lacking[0]}; smooth windows take both derivatives off the position"
    return RIEC(bump.windows.between(alpha, beta), bump.test_function, why)


def _with_elements(model: Model, band: tuple[float, float], records: Sequence[Record]) -> RIEC:
    """Bumps of lengths from what shows the fastest element to what the slowest motion asks for.

    What oscillates shows best in windows of 1.3 of its periods. The shortest serve what is up to
    `FASTER` times the band, or given; no window has fewer samples than its derivatives need. What
    comes late shows in the fastest motion, for which the same lengths serve.
    """
    orders = [t.derivative for stage in model.linear.stages for e in stage for t in e.terms]
    fastest = max([FASTER * band[1], *(element.fastest for element in model.hidden)])
    steps = np.array([float(record.time_step) for record in records])
    durations = np.array([float(record.duration) for record in records])
    half, _ = GradedBump().lengths_of_band(band)
    alpha = max(PERIODS / fastest, GradedBump.fewest_samples * steps.max())
    beta = max(min(2 * float(half), LONGEST * durations.min()), RATIO * alpha)
    count = 1 + int(np.ceil(np.log(beta / alpha) / np.log(RATIO) - 1e-9))
    weight = GradedBump(p=max(8, max(orders) + 5), lengths=count, derivatives=max(orders))
    why = "hidden elements put derivatives in front of every term, which smooth windows take off"
    return RIEC(AllWindows(alpha, beta), weight, why)


def with_velocities(model: Model, record: Record) -> tuple[Record, list[str]]:
    """Add the velocities that functions of an equation read and the record lacks, if it can.

    Slopes of local polynomials of the signals that the equations, or the model's `derived`, call
    them derivatives of (not under jit).

    **Returns:** the record, and what was added, in words.
    """
    steps = []
    for equation in model.equations:
        below = {**model.derived, **{name: of for of, name in equation.derivatives}}
        while any(name not in record.arrays for name in below):
            try:
                equation.signals_read(record, MOST)
                break
            except MissingSignalError as error:
                name, of = error.signal, below.get(error.signal)
                if of not in record.arrays or not xp.is_concrete(record):
                    break
            op = local_slope(record, of)
            record = record.through({name: op})
            steps.append(op.words.format(name))
    return record, steps


# Which of two sensors a damping term reads: the position's, or the velocity's own.
#
# Over a window from t to T the term r x' is r (x(T) - x(t)), or the integral of a recorded
# velocity. Without noise both are the same. Noise adds twice the position's variance to the first,
# and to the second the velocity's times the window's length times a time step: a hundredth of it,
# if both have the same share of noise and the window holds some dozens of samples.

NOTICED = 0.02
"""Noise of a position, as a share of its standard deviation, below which it is read in any case:
the equation error then decides how far parameters scatter."""


# What overflows is for the fit to refuse.
@np.errstate(over="ignore", invalid="ignore")
def with_less_noise(model: Model, record: Record, criterion: AbstractCriterion) -> Model:
    """The model whose first derivatives are read from the sensor that adds less noise.

    The same unless boxcars are summed, where the position has little noise, and where nothing is
    known of the velocity's own. Under trace a term is of both sensors, with a factor of 0 and 1.
    """
    windows, noise = criterion.windows, record.noise
    if windows is None or criterion.test_function.smoothness != 1:
        return model
    length = 0.5 * (xp.asarray(windows.alpha) + xp.asarray(windows.beta))

    def read(term: AbstractTerm) -> list[AbstractTerm]:
        position, (velocity, *measured) = term.signal, term.measured or ("",)
        if (
            position is None
            or term.derivative != 1
            or velocity not in noise.kernels
            or noise.is_made_of(velocity, position)
            or not {velocity, position} <= {*record.arrays}
        ):
            return [term]
        # What lies next to each other adds up in an integral, as the sum of a filter's taps does.
        kernels = noise.kernels[velocity].values()
        density = sum((xp.sum(xp.asarray(taps)) ** 2 for taps in kernels), np.zeros(()))
        by_velocity = length * xp.asarray(record.time_step) * density
        by_position = 2 * noise.std(position) ** 2
        noticed = by_position > 2 * NOTICED**2 * xp.var(xp.asarray(record.arrays[position]))
        chosen = noticed & (by_velocity < by_position)
        integrated = term.with_fields(of=velocity, derivative=0, measured=tuple(measured))
        if xp.is_concrete(chosen):
            return [integrated if chosen else term]
        share, factor = xp.asarray(chosen, float), term.factor
        return [
            term.with_fields(factor=factor * (1 - share)),
            integrated.with_fields(factor=factor * share),
        ]

    def of(equation: Equation) -> Equation:
        return equation.of_terms(*(each for term in equation.terms for each in read(term)))

    return Model(stages=model.by_stage(of))
