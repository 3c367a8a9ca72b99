"""Running sums and integrals of sampled functions, of stated order in the time step.

**Order.** Between two samples the integrand is replaced by the polynomial of degree m - 1 through
the m samples nearest to them, centred on the interval. Its integral errs by O(h^(m + 1)), and over
a window, which has T / h intervals, by O(h^m).

**End corrections.** Weights of one interval are 1/2, 1/2 for m = 2 and (-1, 13, 13, -1) / 24 for
m = 4. Added up over the intervals from sample a to sample b, inner samples get the weight 1
whatever m is, so the orders differ near the ends of a window only:

    I_4 = I_2 - h / 24 ((s[b + 1] - s[b - 1]) - (s[a + 1] - s[a - 1]))

which is the correction of Euler and Maclaurin, -h^2 / 12 (s'(b) - s'(a)), with central differences
for s'. Order m reads m / 2 - 1 samples beyond either end of a window: hence a margin at chunks. At
the record's own ends, the polynomial through its first (last) m samples serves several intervals.

**Primitives.** An s-fold integral over a window is an s-th difference of the s-th running integral,
so that one running integral serves all windows. That of a signal with mean c grows as c t^s / s!,
and a difference over k of N samples would lose log10((N / k)^s) digits. The mean's part is
therefore left out of the running integral and added in closed form: the s-th difference of
c t^s / s! over steps of length L is c L^s exactly.
"""

from functools import lru_cache

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

ROW = 16
"""Samples to a row: so many products each costs, and one sixteenth is left to sum over rows."""
TRIANGLE = np.triu(np.ones((ROW, ROW)))


@jax.jit  # is called dozens of times in one trace, of few shapes
def running_sum(values: Float[Array, "columns n"]) -> Float[Array, "columns n"]:
    """Sum of the samples up to each, itself included.

    By rows of 16 samples, each times a triangle of ones, and then over the rows' totals likewise.
    A matrix product is many times faster than a scan, and sums of sums round as log n, not n.
    """
    columns, n = values.shape
    if n <= 2 * ROW:
        return jnp.cumsum(values, axis=1)
    rows = -(-n // ROW)
    padded = jnp.pad(values, ((0, 0), (0, rows * ROW - n)))
    triangle = jnp.asarray(TRIANGLE, values.dtype)
    # Accelerators would otherwise multiply 32-bit numbers with ten bits.
    within = jnp.matmul(
        padded.reshape(columns * rows, ROW), triangle, precision=jax.lax.Precision.HIGHEST
    ).reshape(columns, rows, ROW)
    totals = within[:, :, -1]
    before = running_sum(totals) - totals
    return (within + before[:, :, None]).reshape(columns, rows * ROW)[:, :n]


def sum_between(
    values: Array, first: Int[Array, " n"], last: Int[Array, " n"], stride: int = 1
) -> Float[Array, "columns n"]:
    """Sum of values, shape `(columns, n)`, at `first`, `first + stride`, ... `last`.

    One difference S[last + stride] - S[first] of the running sum S[i] = values[i - stride] +
    values[i - 2 stride] + ... For `last = first - stride` it is zero.
    """
    columns, n = values.shape
    if stride == 1:
        running = jnp.pad(running_sum(values), ((0, 0), (1, 0)))
    else:
        padded = jnp.pad(values, ((0, 0), (stride, -n % stride)))
        running = jnp.cumsum(padded.reshape(columns, -1, stride), axis=1)
        running = running.reshape(columns, -1)[:, : n + stride]
    end = n + stride - 1
    return running[:, jnp.clip(last + stride, 0, end)] - running[:, jnp.clip(first, 0, end)]


ORDERS = (2, 4, 6, 8)


def running_integral(
    samples: Float[Array, "columns n"],
    order: int = 2,
    present: Bool[Array, " n"] | None = None,
    unpadded: Int[Array, ""] | int | None = None,
) -> Float[Array, "columns n"]:
    """Integral from the first sample to each, in units of the time step.

    An interval whose polynomial would reach over a missing sample takes the trapezoid instead. Of a
    padded record, the last sample of its own is number `unpadded - 1`.
    """
    areas = 0.5 * (samples[:, 1:] + samples[:, :-1])
    order = min(order, 2 * (samples.shape[1] // 2))
    if order > 2:
        # Of the polynomial centred on each interval; at either end of one for several.
        n, reach = samples.shape[1], order // 2 - 1
        inner = n - order + 1
        weights = interval_weights(order, reach)
        middle = sum(
            (float(w) * samples[:, j : j + inner] for j, w in enumerate(weights[1:], 1)),
            start=float(weights[0]) * samples[:, :inner],
        )
        first = [samples[:, :order] @ interval_weights(order, i) for i in range(reach)]
        end = n if unpadded is None else jnp.maximum(unpadded, order)
        tail = jax.lax.dynamic_slice_in_dim(samples, end - order, order, axis=1)
        behind = [tail @ interval_weights(order, order - 1 - reach + i) for i in range(reach)]
        behind = jnp.stack(behind, 1)
        higher = jnp.concatenate([jnp.stack(first, 1), middle, behind], axis=1)
        higher = jax.lax.dynamic_update_slice_in_dim(higher, behind, end - 1 - reach, axis=1)
        if present is None:
            areas = higher
        else:  # where every sample of an interval's polynomial is present
            absent = jnp.pad(jnp.cumsum(~present), (1, 0))
            first = np.clip(np.arange(n - 1) - (order // 2 - 1), 0, n - order)
            areas = jnp.where((absent[first + order] == absent[first])[None, :], higher, areas)
    return jnp.pad(running_sum(areas), ((0, 0), (1, 0)))


@lru_cache
def interval_weights(order: int, interval: int) -> Float[np.ndarray, " order"]:
    """Weights of `order` samples at 0, 1, ... whose sum is the integral over one interval.

    The integral from `interval` to `interval + 1` of the polynomial through them.
    """
    # Centred on the interval, monomials stay small and the Vandermonde system well conditioned.
    nodes = np.arange(order) - (interval + 0.5)
    powers = np.arange(order)
    integrals = (0.5 ** (powers + 1) - (-0.5) ** (powers + 1)) / (powers + 1)
    return np.linalg.solve(np.vander(nodes, increasing=True).T, integrals)


def unpadded_mean(
    values: Float[Array, "columns n"], unpadded: Int[Array, ""] | int | None
) -> Float[Array, " columns"]:
    """Mean of the first `unpadded` samples, of all by default."""
    if unpadded is None or (isinstance(unpadded, int) and unpadded == values.shape[1]):
        return jnp.mean(values, axis=1)
    inside = jnp.arange(values.shape[1]) < unpadded
    return jnp.sum(jnp.where(inside[None, :], values, 0.0), axis=1) / unpadded


class Primitives(eqx.Module):
    """For each column of an equation, the function whose s-th differences are its integrals.

    **Fields:**

    - `values`: the s-th running integral of the column less its mean, shape `(columns, n)`.
    - `mean`: the mean times the time step to the power s, shape `(columns,)`.
    - `bend`: increase of the primitive's slope from each sample to the next.
    - `present`: where every column has its sample and the equation is to be trusted; `None`
      where that is everywhere.
    - `difference`: s, 1 for the boxcar and 2 for the hat.
    """

    values: Float[Array, "columns n"]
    mean: Float[Array, " columns"]
    bend: Float[Array, "columns n-1"]
    present: Bool[Array, " n"] | None
    difference: int = eqx.field(static=True)

    def differences(self, start: Array, stop: Array) -> Float[Array, "columns windows"]:
        """Integral of every column over every window, of integer or (for s = 1) real ends."""
        step = (stop - start) / self.difference
        polynomial = self.mean[:, None] * (step**self.difference)[None, :]
        ends = self._at(stop) + (-1) ** self.difference * self._at(start)
        middle = 2 * self._at((start + stop) // 2) if self.difference == 2 else 0.0
        return ends - middle + polynomial

    def _at(
        self, position: Int[Array, " windows"] | Float[Array, " windows"]
    ) -> Float[Array, "columns windows"]:
        if jnp.issubdtype(position.dtype, jnp.integer):
            # A window's columns lie side by side then: one line of cache instead of one for each.
            return self.values.T[position].T
        # Between samples the integrand is the straight line s_i + x (s_i+1 - s_i), 0 <= x <= 1, so
        # its primitive is F_i + x (F_i+1 - F_i) - x (1 - x) / 2 (s_i+1 - s_i).
        below = jnp.clip(position.astype(jnp.int32), 0, self.values.shape[1] - 2)
        share = (position - below)[None, :]
        left, right = self.values[:, below], self.values[:, below + 1]
        return left + share * (right - left) - 0.5 * share * (1 - share) * self.bend[:, below]
