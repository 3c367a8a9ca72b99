"""The equation error over time: what identified equations leave at each sample.

No signal is differentiated numerically. Each value is the mean error over the shortest window
there is. For M v' = F over one sample interval h,

    (1/h) integral (M v' - F) dt = M (v(t + h) - v(t)) / h - mean F,

in which a velocity's difference is exactly the mean acceleration. Where only the position of an
acceleration is recorded, the window is a triangle of height 1/h over two intervals, and the
integral of x'' under it is (x(t + 2h) - 2 x(t + h) + x(t)) / h^2. Errors of longer
windows are sums of these values times h: the impulse's rise.
"""

import dataclasses
from collections.abc import Mapping, Sequence
from typing import Any

import equinox as eqx
import numpy as np
from jaxtyping import Bool, Float

from riecjax import arrays as xp
from riecjax.arrays import Array
from riecjax.criteria.test_functions import Boxcar, Hat
from riecjax.criteria.windows import WindowSet
from riecjax.elements.catalogue import trusted, with_states
from riecjax.equations.equation import Equation
from riecjax.equations.model import Model, as_model
from riecjax.equations.noisy_columns import sampled_columns
from riecjax.errors import DataError, ModelError
from riecjax.estimation.parameters import values_in_recording
from riecjax.leaves import Leaf, PlainMethods
from riecjax.records.record import Record, runs


def share_of(part: Any, whole: Any) -> Any:
    """part / whole, and zero, derivatives too, where the whole is none."""
    there = whole > 0
    return xp.where(there, part / xp.where(there, whole, 1.0), 0.0)


class EquationError(PlainMethods, eqx.Module):
    """What one equation leaves over time, in the equation's unit.

    The equation reads `target = explained + error`. Its target is the term without a coefficient,
    such as a measured force, or else the first coefficient's.

    **Fields:**

    - `error`: mean equation error over each shortest window, shape `(n - span,)`; zero where it
      is not `present`.
    - `explained`: mean of what the regressors and their parameters give there, of the same shape.
    - `present`: False where a window touches a missing or masked sample.
    - `time_step`: seconds from each value to the next, scalar.
    - `span`: samples in a window: 1, or 2 where a second derivative had to be moved.
    - `name`, `unit`: of the equation.
    - `times`: middle of each window in seconds from the recording's first sample, of the same
      shape as `error`.
    """

    error: Float[Leaf, " values"]
    explained: Float[Leaf, " values"]
    present: Bool[Leaf, " values"]
    time_step: Float[Leaf, ""]
    span: int = eqx.field(static=True)
    name: str = eqx.field(static=True)
    unit: str = eqx.field(static=True)
    times: Float[Leaf, " values"]

    def runs(self) -> list[slice]:
        """Stretches in which it is present (not under jit)."""
        return [slice(a, b) for a, b in runs(np.asarray(self.present)).T.tolist()]

    @property
    def target(self) -> Float[Leaf, " values"]:
        """What the model was to explain."""
        return self.explained + self.error

    @property
    def impulse(self) -> Float[Leaf, " values"]:
        """Integral of the error from the first sample to the end of each window, in unit x s.

        Its rise over a window is that window's error in eq. (17); eq. (8) bounds it where modes
        are all that the model leaves out. Values that are not present add nothing.
        """
        return self.error.cumsum() * self.time_step

    @property
    def relative_rms(self) -> Float[Array, ""]:
        """Root mean square of the error relative to the target's; zero of a silent target."""
        squares = (xp.sum(xp.square(values)) for values in (self.error, self.target))
        return xp.sqrt(share_of(*squares))


def equation_error(
    model: Equation | Model, record: Record, values: Mapping[str, float | Array]
) -> tuple[EquationError, ...]:
    """The equation error of every equation of a model, in the order of its stages.

    Works under `jax.jit` and `jax.vmap`. Integrals inside a window are of the highest order, so
    that what is left is the model's error, not the quadrature's. Hidden masses move as their
    bodies make them; what they did before the record is given time to decay.

    **Arguments:** `values`: parameter name to value, such as an estimate's `values`.

    **Raises:** `ModelError` for a parameter without a value, `DataError` for a missing signal or
    a record of fewer than three samples.
    """
    model = as_model(model)
    if missing := [name for name in model.parameter_names if name not in values]:
        raise ModelError(f"the equation error needs a value of '{missing[0]}'.")
    record, values = xp.hosted((record, dict(values)), double=True)
    given = {name: xp.asarray(values[name]) for name in model.parameter_names}
    if model.has_hidden:
        from riecjax.equations.element_motion import with_element_motion

        model, record = with_element_motion(model, record, given)
    errors = []
    for equation in model.equations:
        # The boxcar, if the record holds every derivative that it needs.
        weight = Boxcar()
        try:
            for term in equation.terms:
                term.expression(record, max(term.derivative - weight.smoothness, 0))
        except DataError:
            weight = Hat()
        span, step = weight.smoothness, record.time_step
        if record.sample_count <= span + 1:
            raise DataError(
                f"{equation.name}: a record of {record.sample_count} samples has no equation error "
                f"over time."
            )
        start = np.arange(record.sample_count - span)
        sampled = sampled_columns(equation, record, weight.smoothness)
        columns, whole = weight.finest().integrals(sampled, WindowSet(start, start + span))
        present = np.ones(start.shape, bool) if whole is None else whole
        target, *regressors = xp.where(present[None, :], columns / step**span, 0.0)
        parts = {
            name: given[name] * column
            for name, column in zip(equation.parameters, regressors, strict=True)
        }
        if not equation.has_target:
            target = -parts.pop(equation.parameters[0])
        explained: Any = sum(parts.values(), start=xp.zeros_like(target))
        times = 0.5 * (record.elapsed[span:] + record.elapsed[:-span])
        error = EquationError(
            target - explained, explained, present, step, span, equation.name, equation.unit, times
        )
        errors.append(error)
    return tuple(errors)


def errors_over_records(
    model: Equation | Model, records: Sequence[Record], values: Mapping[str, float | Array]
) -> list[list[EquationError]]:
    """For each equation, its error on each of several records (not under jit).

    A parameter that is estimated per record, such as `offset[2]`, takes that record's value.

    **Raises:** as [`equation_error`][].
    """
    model = as_model(model)
    records = [with_states(model, record) for record in records]
    parts = []
    for index, record in enumerate(records):
        own = values_in_recording(model.parameter_names, values, index)
        parts.append(equation_error(trusted(model, record), record, own))
    return [list(of_equation) for of_equation in zip(*parts)]


def joined(errors: Sequence[EquationError]) -> EquationError:
    """One equation's errors on several records, one record after the other.

    Between records stands a value that is not present, and times go on. Arrays are NumPy's, for
    tests and figures.
    """
    series = {}
    for field in ("error", "explained", "present"):
        parts = [np.pad(np.asarray(getattr(part, field)), (0, 1)) for part in errors]
        series[field] = np.concatenate(parts)[:-1]
    first, step = errors[0], float(errors[0].time_step)
    times = [np.asarray(first.times)]
    for part in errors[1:]:
        between, own = times[-1][-1:] + step, np.asarray(part.times)
        times += [between, own - own[0] + between + step]
    return dataclasses.replace(
        first,
        **series,
        time_step=np.asarray(first.time_step),
        times=np.concatenate(times),
    )
