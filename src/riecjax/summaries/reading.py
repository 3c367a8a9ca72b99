"""Which of two sensors a damping term reads: the position's, or the velocity's own.

Over a window from t to T the term r x' is r (x(T) - x(t)), or the integral of a recorded velocity.
Without noise both are the same. Noise adds twice the position's variance to the first, and to the
second the velocity's times the window's length times a time step: a hundredth of it, if both have
the same share of noise and the window holds some dozens of samples.
"""

from riecjax.criteria.criterion import AbstractCriterion
from riecjax.equations.equation import Equation
from riecjax.equations.procedure import Procedure
from riecjax.equations.term import AbstractTerm, Term
from riecjax.leaves import is_concrete
from riecjax.records.record import Record


def with_less_noise(
    procedure: Procedure, record: Record, criterion: AbstractCriterion
) -> Procedure:
    """The procedure whose first derivatives are read from the sensor that adds less noise.

    The same unless boxcars are summed, and where nothing is known of the velocity's own noise.
    """
    windows = criterion.windows
    known = is_concrete(windows, record.noise, record.time_step)
    if windows is None or criterion.test_function.smoothness != 1 or not known:
        return procedure
    length = 0.5 * (float(windows.alpha) + float(windows.beta))

    def read(term: AbstractTerm) -> AbstractTerm:
        if not (isinstance(term, Term) and term.derivative == 1 and term.measured):
            return term
        position, velocity = term.of, term.measured[0]
        if not isinstance(position, str) or velocity not in record.arrays:
            return term
        noise = record.noise
        by_position = 2 * float(noise.std(position)) ** 2
        by_velocity = length * float(record.time_step) * float(noise.std(velocity)) ** 2
        own = by_velocity > 0 and not noise.is_made_of(velocity, position)
        if not (own and by_velocity < by_position):
            return term
        return term.of_its_derivative()

    def of(equation: Equation) -> Equation:
        terms = map(read, equation.terms)
        return Equation(*terms, name=equation.name, unit=equation.unit, where=equation.where)

    return Procedure(tuple(tuple(map(of, stage)) for stage in procedure.stages))
