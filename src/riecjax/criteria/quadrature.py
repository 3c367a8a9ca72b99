"""Running integrals of sampled functions, of stated order in the time step."""

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

ROW = 16
"""Samples to a row: so many products each costs, and one sixteenth is left to sum over rows."""


def running_sum(values: Float[Array, "columns n"]) -> Float[Array, "columns n"]:
    """Sum of the samples up to each, itself included."""
    columns, n = values.shape
    if n <= 2 * ROW:
        return jnp.cumsum(values, axis=1)
    rows = -(-n // ROW)
    padded = jnp.pad(values, ((0, 0), (0, rows * ROW - n)))
    triangle = jnp.asarray(np.triu(np.ones((ROW, ROW))), values.dtype)
    # Accelerators would otherwise multiply 32-bit numbers with ten bits.
    within = jnp.matmul(
        padded.reshape(columns * rows, ROW), triangle, precision=jax.lax.Precision.HIGHEST
    ).reshape(columns, rows, ROW)
    totals = within[:, :, -1]
    before = running_sum(totals) - totals
    return (within + before[:, :, None]).reshape(columns, rows * ROW)[:, :n]


ORDERS = (2, 4, 6, 8)


def running_integral(
    samples: Float[Array, "columns n"],
    order: int = 2,
    present: Bool[Array, " n"] | None = None,
    held: Int[Array, ""] | int | None = None,
) -> Float[Array, "columns n"]:
    """Integral from the first sample to each, in units of the time step.

    Between two samples the integrand is the polynomial of degree `order - 1` through the `order`
    samples nearest to them: a straight line (trapezoids) for order 2, a cubic for order 4. The
    first and last intervals use the record's first and last `order` samples, which keeps
    the order; an interval whose polynomial would reach over a missing sample falls back to the
    trapezoid. Of a record that is filled up, its last sample is number `held - 1`.
    """
    areas = 0.5 * (samples[:, 1:] + samples[:, :-1])
    order = min(order, 2 * (samples.shape[1] // 2))
    if order > 2:
        higher = _interval_integrals(samples, order, held)
        areas = higher if present is None else jnp.where(_intact(present, order), higher, areas)
    return jnp.pad(running_sum(areas), ((0, 0), (1, 0)))


def interval_weights(order: int, interval: int) -> Float[np.ndarray, " order"]:
    """Weights of `order` samples at 0, 1, ... whose sum is the integral over one interval.

    The integral from `interval` to `interval + 1` of the polynomial through them.
    """
    # Centred on the interval, monomials stay small and the Vandermonde system well conditioned.
    nodes = np.arange(order) - (interval + 0.5)
    powers = np.arange(order)
    integrals = (0.5 ** (powers + 1) - (-0.5) ** (powers + 1)) / (powers + 1)
    return np.linalg.solve(np.vander(nodes, increasing=True).T, integrals)


def _interval_integrals(
    samples: Float[Array, "columns n"], order: int, held: Int[Array, ""] | int | None
) -> Float[Array, "columns n-1"]:
    n, reach = samples.shape[1], order // 2 - 1
    inner = n - order + 1
    weights = interval_weights(order, reach)
    middle = sum(float(w) * samples[:, j : j + inner] for j, w in enumerate(weights))
    first = [samples[:, :order] @ interval_weights(order, i) for i in range(reach)]
    end = n if held is None else jnp.maximum(held, order)
    tail = jax.lax.dynamic_slice_in_dim(samples, end - order, order, axis=1)
    last = [tail @ interval_weights(order, order - 1 - reach + i) for i in range(reach)]
    assert isinstance(middle, Array)
    if not reach:
        return middle
    behind = jnp.stack(last, 1)
    areas = jnp.concatenate([jnp.stack(first, 1), middle, behind], axis=1)
    return jax.lax.dynamic_update_slice_in_dim(areas, behind, end - 1 - reach, axis=1)


def _intact(present: Bool[Array, " n"], order: int) -> Bool[Array, "1 n-1"]:
    """Where every sample of an interval's polynomial is present."""
    n, reach = present.shape[0], order // 2 - 1
    absent = jnp.pad(jnp.cumsum(~present), (1, 0))
    first = np.clip(np.arange(n - 1) - reach, 0, n - order)
    return (absent[first + order] == absent[first])[None, :]
