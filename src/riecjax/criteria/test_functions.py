"""Test functions: the weight that a window gives to the equation of motion inside it."""

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from riecjax.criteria.windows import WindowSet
from riecjax.equations.equation import Equation
from riecjax.equations.term import AbstractTerm, sum_columns
from riecjax.records.record import Record


class Primitives(eqx.Module):
    """For each column of an equation, the function whose increment over a window is its integral.

    Each is kept as the straight line of its mean slope plus what is left. Of a signal with an
    offset the running integral grows with the record, and the difference of two large
    numbers would lose in 32-bit what the line keeps exactly.

    **Fields:**

    - `values`: what is left, at the samples, shape `(columns, n)`.
    - `slope`: mean slope of each column per sample, shape `(columns,)`.
    - `bend`: increase of the column's slope from each sample to the next, per sample. Between
      samples an integrand is a straight line, so its primitive is a parabola with this bend.
    """

    values: Float[Array, "columns n"]
    slope: Float[Array, " columns"]
    bend: Float[Array, "columns n-1"]

    def increments(self, windows: WindowSet) -> Float[Array, "columns windows"]:
        """Integral of every column over every window."""
        line = self.slope[:, None] * (windows.stop - windows.start)[None, :]
        return self._at(windows.stop) - self._at(windows.start) + line

    def _at(
        self, position: Int[Array, " windows"] | Float[Array, " windows"]
    ) -> Float[Array, "columns windows"]:
        if jnp.issubdtype(position.dtype, jnp.integer):
            return self.values[:, position]
        below = jnp.clip(position.astype(jnp.int32), 0, self.values.shape[1] - 2)
        share = (position - below)[None, :]
        left, right = self.values[:, below], self.values[:, below + 1]
        return left + share * (right - left) - 0.5 * share * (1 - share) * self.bend[:, below]


class Boxcar(eqx.Module):
    """Weight 1 inside the window, 0 outside: RIEC as published.

    Integrates the equation once. A term with a derivative becomes a difference between the ends
    of the window, the paper's Delta x, so that velocities stand where DOLS needs
    accelerations. Integrals are trapezoidal, of second order in the time step.
    """

    def primitives(self, equation: Equation, record: Record) -> Primitives:
        """Primitives of the target (first row) and of every named coefficient's column."""
        parts = [_boxcar_primitives(term, record) for term in equation.terms]
        terms, names = equation.terms, equation.parameters
        return Primitives(
            sum_columns(terms, [part.values for part in parts], names),
            sum_columns(terms, [part.slope[:, None] for part in parts], names)[:, 0],
            sum_columns(terms, [part.bend for part in parts], names),
        )


def _boxcar_primitives(term: AbstractTerm, record: Record) -> Primitives:
    if term.derivative > 0:
        values = term.samples(record, term.derivative - 1)
        zero = jnp.zeros_like(values)
        return Primitives(values, zero[:, 0], zero[:, :-1])
    integrand = term.samples(record, 0) * record.time_step
    mean = jnp.mean(integrand, axis=1)
    return Primitives(
        running_integral(integrand - mean[:, None]), mean, jnp.diff(integrand, axis=1)
    )


def running_integral(samples: Float[Array, "columns n"]) -> Float[Array, "columns n"]:
    """Trapezoidal integral from the first sample to each, in units of the time step."""
    areas = 0.5 * (samples[:, 1:] + samples[:, :-1])
    return jnp.pad(jnp.cumsum(areas, axis=1), ((0, 0), (1, 0)))
