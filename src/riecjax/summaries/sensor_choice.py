"""Which of two sensors a damping term reads: the position's, or the velocity's own.

Over a window from t to T the term r x' is r (x(T) - x(t)), or the integral of a recorded velocity.
Without noise both are the same. Noise adds twice the position's variance to the first, and to the
second the velocity's times the window's length times a time step: a hundredth of it, if both have
the same share of noise and the window holds some dozens of samples.
"""

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool

from riecjax.criteria.criterion import AbstractCriterion
from riecjax.equations.equation import Equation
from riecjax.equations.model import Model
from riecjax.equations.term import AbstractTerm
from riecjax.leaves import is_concrete, namespace
from riecjax.records.record import Record

NOTICED = 0.02
"""Noise of a position, as a share of its standard deviation, below which it is read in any case:
the equation error then decides how far parameters scatter."""


def with_less_noise(model: Model, record: Record, criterion: AbstractCriterion) -> Model:
    """The model whose first derivatives are read from the sensor that adds less noise.

    The same unless boxcars are summed, where the position has little noise, and where nothing is
    known of the velocity's own. Under trace a term is of both sensors, with a factor of 0 and 1.
    """
    if criterion.windows is None or criterion.test_function.smoothness != 1:
        return model

    def read(term: AbstractTerm) -> list[AbstractTerm]:
        if not _has_both(term, record):
            return [term]
        chosen = _adds_less(term.measured[0], str(term.of), record, criterion)
        velocity, *measured = term.measured
        by_velocity = term.with_fields(of=velocity, derivative=0, measured=tuple(measured))
        if is_concrete(chosen):
            return [by_velocity if chosen else term]
        share = jnp.asarray(chosen, float)
        factor = jnp.asarray(term.factor)
        return [
            term.with_fields(factor=factor * (1 - share)),
            by_velocity.with_fields(factor=factor * share),
        ]

    def of(equation: Equation) -> Equation:
        return equation.of_terms(*(each for term in equation.terms for each in read(term)))

    return Model(stages=model.by_stage(of))


def _has_both(term: AbstractTerm, record: Record) -> bool:
    """Whether the record holds a signal and its derivative by a sensor whose noise is known."""
    if term.signal is None or term.derivative != 1 or not term.measured:
        return False
    velocity, noise = term.measured[0], record.noise
    own = velocity in noise.kernels and not noise.is_made_of(velocity, term.signal)
    return own and velocity in record.arrays and term.signal in record.arrays


# What overflows is for the fit to refuse.
@np.errstate(over="ignore", invalid="ignore")
def _adds_less(
    velocity: str, position: str, record: Record, criterion: AbstractCriterion
) -> Bool[Array, ""] | np.bool_:
    """Whether the integral of a velocity has less noise than a noisy position's difference."""
    windows, noise = criterion.windows, record.noise
    assert windows is not None
    xp = namespace(windows, record)
    length = 0.5 * (xp.asarray(windows.alpha) + xp.asarray(windows.beta))
    # What lies next to each other adds up in an integral, as the sum of a filter's taps does.
    kernels = noise.kernels[velocity].values()
    density = sum((xp.sum(xp.asarray(taps)) ** 2 for taps in kernels), np.zeros(()))
    by_velocity = length * xp.asarray(record.time_step) * density
    by_position = 2 * noise.std(position) ** 2
    noticed = by_position > 2 * NOTICED**2 * xp.var(xp.asarray(record.arrays[position]))
    return noticed & (by_velocity < by_position)
