"""An equation's columns averaged by hats and looked at sample by sample, reduced to sums."""

# A hat of h samples to a side, w(s) = (1 - |s| / h) / h, has the second derivative delta(-h) -
# 2 delta(0) + delta(h), over h^2. By parts, the mean of f under it is the second difference of f's
# second integral I over h, (I(t + h) - 2 I(t) + I(t - h)) / h^2; of f = d^k/dt^k c it is that of c
# integrated 2 - k times. So no derivative is ever taken of a sample, and one running sum serves all
# hats. What is constant in f adds a parabola to I, whose values grow with the record's square while
# its second difference does not: in 32-bit it would leave nothing of what varies. So means are
# removed before integration and put back behind it, and so are constants of integration, which the
# second difference does not see.
#
# Rows of such means become a triangular factor, which has every norm and least-squares solution
# that the rows have.

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from riecjax.criteria.criterion import AbstractCriterion
from riecjax.criteria.quadrature import running_sum
from riecjax.equations.equation import Equation
from riecjax.equations.noisy_columns import Columns
from riecjax.leaves import Leaf, namespace
from riecjax.summaries.sums import Activity


def hat_half(
    criterion: AbstractCriterion, held: int | Int[Array, ""], time_step: Leaf
) -> Int[Leaf, ""]:
    """Samples to each side of a hat as long as the criterion's typical window.

    0 for a criterion without windows. **Arguments:** `held`, how many samples there are.
    """
    length = criterion.typical_length
    xp = namespace(length, held, time_step)
    most = xp.maximum((xp.asarray(held) - 2) // 2, 1)
    half = xp.clip(xp.round(length / (2 * time_step)), 1, most)
    return xp.where(length > 0, half, 0).astype(np.int32)


def thinned(columns: Columns, by: int) -> Columns:
    """Means of so many samples each, in place of these; what is left over at the end is dropped.

    All columns are filtered alike, so that an equation that holds for the samples holds for the
    means: under hats several times as long, these tell what the samples would.
    """
    if by == 1:
        return columns
    count = columns.sample_count // by
    values = columns.values[..., : count * by].reshape(*columns.values.shape[:-1], count, by)
    present = columns.present
    if present is not None:
        present = jnp.all(present[: count * by].reshape(count, by), axis=1)
    return Columns(jnp.mean(values, axis=-1), present, by * columns.time_step, columns.parameters)


def averaged_rows(
    columns: Columns,
    half: int | Int[Leaf, ""],
    centres: Int[Array, " rows"],
    held: int | Int[Array, ""],
) -> tuple[Float[Array, "rows columns"], Bool[Array, " rows"]]:
    """Means of every column under hats, and which of the hats touch nothing but samples present.

    Rows of other hats are zero.

    **Arguments:** `half`, samples to each side, 0 for the sample itself; `centres` of the hats;
    `held`, how many samples are real: what follows is padding, of any finite value.
    """
    there = _there(columns, held)
    first, last = centres - half, centres + half
    n = columns.sample_count
    absent = jnp.pad(jnp.cumsum(~there), (1, 0))
    whole = absent[jnp.clip(last + 1, 0, n)] == absent[jnp.clip(first, 0, n)]
    valid = (first >= 0) & (last < n) & whole

    count = jnp.maximum(jnp.sum(there), 1)
    mean = jnp.sum(jnp.where(there[None, None, :], columns.values, 0.0), -1, keepdims=True) / count
    # A constant under no derivative is its own mean, and vanishes under one; neither needs to be
    # integrated, which would lose in 32-bit what varies beside it.
    varying = jnp.where(there[None, None, :], columns.values - mean, 0.0)
    integrated = varying[0]
    for order in (1, 2):
        # Trapezia but for a constant of integration, which vanishes as these do.
        integrated = integrated - jnp.mean(integrated, axis=1, keepdims=True)
        integrated = columns.time_step * (running_sum(integrated) - 0.5 * integrated)
        if order <= columns.smoothness:
            integrated = integrated + varying[order]

    def at(position: Array) -> Array:
        return integrated[:, jnp.clip(position, 0, n - 1)]

    second_difference = at(last) - 2 * at(centres) + at(first)
    hats = mean[0] + second_difference / (jnp.maximum(half, 1) * columns.time_step) ** 2
    samples = columns.values[0][:, jnp.clip(centres, 0, n - 1)]
    rows = jnp.where(jnp.asarray(half) == 0, samples, hats)
    return jnp.where(valid[None, :], rows, 0.0).T, valid


def _there(columns: Columns, held: int | Int[Array, ""]) -> Bool[Array, " n"]:
    real = jnp.arange(columns.sample_count) < held
    return real if columns.present is None else real & columns.present


def activity(
    columns: Columns, there: Bool[Array, " n"], bare: Bool[np.ndarray, " columns"] | None = None
) -> Activity:
    """Powers of the columns over the samples that are there, and their products.

    Products are summed, and `samples` counted, where a difference reaches no other sample.

    **Arguments:** `bare`, which columns stand under no derivative, where that does not show
    because columns hold recorded derivatives.
    """
    values = jnp.where(there[None, None, :], columns.values, 0.0)
    free = values[0] if bare is None else jnp.where(jnp.asarray(bare)[:, None], values[0], 0.0)
    equation, inside = values[-1], there
    for order in range(columns.smoothness)[::-1]:
        slope = jnp.asarray(jnp.gradient(equation, axis=1)) / columns.time_step
        equation = values[order] + slope
        ends = jnp.pad(inside, 1, constant_values=True)
        inside = inside & ends[2:] & ends[:-2]
    equation = jnp.where(inside[None, :], equation, 0.0)
    return Activity(
        jnp.sum(free**2, axis=1),
        jnp.sum(free**4, axis=1),
        jnp.matmul(equation, equation.T, precision=jax.lax.Precision.HIGHEST),
        jnp.sum(inside, dtype=values.dtype),
    )


def underived(equation: Equation) -> Bool[np.ndarray, " columns"]:
    """Which of an equation's columns, the target first, have no term under a derivative."""
    derived = [name for t in equation.terms if t.derivative for name in t.parameters or ("",)]
    return np.array([name not in derived for name in ("", *equation.parameters)])
