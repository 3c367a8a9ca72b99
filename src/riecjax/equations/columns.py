"""An equation's columns, sampled: what every criterion integrates, compares or adds up."""

from collections.abc import Sequence

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from riecjax.equations.equation import Equation
from riecjax.equations.expressions import Sampled
from riecjax.equations.term import sum_columns
from riecjax.records.record import Record


class Columns(eqx.Module):
    """Samples of the target and of every regressor, by the derivative still in front of them.

    The column of a coefficient is `sum_k d^k/dt^k values[k]`: what a test function of smoothness s
    takes off the motion stays in front, k = 0 to s, and every higher derivative was recorded.

    **Fields:**

    - `values`: the target first, shape `(1 + s, 1 + p, n)`.
    - `present`: where every column has its sample and the equation is to be trusted; `None`
      where that is everywhere.
    - `time_step`: seconds between samples.
    - `parameters`: names of the p regressors.
    """

    values: Float[Array, "orders columns n"]
    present: Bool[Array, " n"] | None
    time_step: Float[Array, ""]
    parameters: tuple[str, ...] = eqx.field(static=True)

    @property
    def sample_count(self) -> int:
        """Number of samples n."""
        return self.values.shape[-1]

    @property
    def smoothness(self) -> int:
        """Derivatives that a test function has to take off: s."""
        return self.values.shape[0] - 1

    def __sub__(self, other: "Columns") -> "Columns":
        """Column by column, such as those of a disturbed record less those of a clean one."""
        return Columns(self.values - other.values, self.present, self.time_step, self.parameters)

    def stretch(self, first: Int[Array, ""] | int, count: int) -> "Columns":
        """`count` samples from `first` on, which may be traced."""

        def cut(values: Array) -> Array:
            return jax.lax.dynamic_slice_in_dim(values, first, count, axis=-1)

        present = None if self.present is None else cut(self.present)
        return Columns(cut(self.values), present, self.time_step, self.parameters)


def sampled_columns(equation: Equation, record: Record, smoothness: int) -> Columns:
    """The columns of an equation, of whose derivatives a criterion takes `smoothness` off.

    **Raises:** `DataError` for a missing signal or derivative.
    """
    read = [term.samples(record, max(term.derivative - smoothness, 0)) for term in equation.terms]
    return columns_of_terms(equation, record, smoothness, read)


def columns_of_terms(
    equation: Equation, record: Record, smoothness: int, read: Sequence[Sampled]
) -> Columns:
    """The columns that samples of each of an equation's terms add up to."""
    names = equation.parameters
    zero = jnp.zeros((1 + len(names), record.sample_count), record.time_step.dtype)

    def of_order(order: int) -> Float[Array, "columns n"]:
        terms = [
            (term, sampled.values)
            for term, sampled in zip(equation.terms, read)
            if min(term.derivative, smoothness) == order
        ]
        return sum_columns(terms, names) if terms else zero

    values = jnp.stack([of_order(order) for order in range(smoothness + 1)])
    return Columns(values, equation.present(record, read), record.time_step, names)
