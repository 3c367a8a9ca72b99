"""Normal equations of all windows in closed form: O(N p^2), however many windows there are.

**The sum.** phi[t] holds the primitives of an equation's 1 + p columns at sample t, the target
first. A window that starts at t with lag k has the row d = phi[t + k] - phi[t] (boxcar), or
phi[t + 2 k] - 2 phi[t + k] + phi[t] (hat, 2 k samples long). For each block B of starts, and a law
w[k] of lags, the normal equations need

    M = sum_{t in B} sum_k w[k] d d^T,    N = sum_{t in B} sum_k w[k]

over the windows that end within the record and hold no missing sample. One by one that costs
O(N K p^2) for K lags.

**Boxcar.** Let windows of total weight s[u] start at sample u and of total weight e[u] end there.
Multiplied out, the squares depend on these weights alone, and the mixed products on one sum:

    M = sum_u (s[u] + e[u]) phi[u] phi[u]^T - X - X^T,
    X = sum_t phi[t] c[t]^T,    c[t] = sum_k w[k] phi[t + k]

Where w is constant from lag a to lag b (a bin of a law), c[t] is w times one difference of the
running sum S[u] = sum_{v < u} phi[v], and so are s and e of the running count R of starts:

    c[t] = w (S[t + b + 1] - S[t + a])
    s[t] = w (b - a + 1),    e[u] = w (R[u - a + 1] - R[u - b])

A bin costs O(N p). The bins' s, e and c are added up before the one product of O(N p^2).

**Hat.** With m[u] the weight of windows whose middle is at u, likewise

    M = sum_u (s[u] + 4 m[u] + e[u]) phi[u] phi[u]^T + Y + Y^T,
    Y = sum_t phi[t] (sum_k w[k] (phi[t + 2 k] - 2 phi[t + k]))^T
        - 2 sum_u phi[u] (sum_k w[k] phi[u + k])^T

where the last sum runs over the windows with their middle at u. The sum over phi[t + 2 k] takes
every second sample, so it is a difference of a running sum of stride 2.

**Gaps.** A window holds no missing sample if and only if it ends in the run of valid samples in
which it starts. With runs from f[u] to l[u], lags from t go up to min(b, l[t] - t) and starts of
windows that end at u begin at max(u - b, f[u]): the same differences between other limits.

**Blocks.** Each window counts in the block that holds its start, so blocks add up to the record:
intervals and resampling need these sums. A block of `size` starts sees `reach` samples beyond,
as long as the longest window, so blocks that are as long as that cost at most twice.

**Precision.** d does not change when a constant is added to phi (a straight line, for the hat),
whereas every term of M does. If phi has the size R and d the size r, terms of R^2 cancel to r^2,
which leaves a relative error of about eps (R / r)^2. The primitive of an offset is a ramp: over N
samples with lags of k, (R / r)^2 = (N / k)^2 / 12, which is 2e4 for 2^15 samples and k = 64, and
an error of 2e-3 in 32-bit. Therefore phi is referred to each block: less its mean there (the
straight line through it, for the hat). Then N is a block's size instead, 256 in the
same example, (R / r)^2 = 2, and the error 1e-7. Running sums begin anew with each block too.

Primitives are running integrals of sampled functions, of stated order in the time step:

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
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from riecjax.criteria.windows import (
    LagBins,
    StartBlocks,
    each_bin,
    products_of_blocks,
    sum_over_bins,
)
from riecjax.leaves import Leaf
from riecjax.records.signal import both

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


class Runs(NamedTuple):
    """Runs of valid samples, and the starts of windows in them.

    **Fields:** `first`, for each sample where the first window starts that may hold it; `last`
    sample of the run it lies in; `stop`, where the last window of all starts.
    """

    first: Int[Array, " n"]
    last: Int[Array, " n"]
    stop: Int[Array, ""] | int

    @classmethod
    def of(
        cls, valid: Bool[Array, " n"], first: Int[Array, ""] | int, count: Int[Array, ""] | int
    ) -> "Runs":
        """Of a mask, and so many starts from the `first` on."""
        at = jnp.arange(valid.shape[0])
        gap_before = jax.lax.cummax(jnp.where(valid, -1, at))
        gap_after = jax.lax.cummin(jnp.where(valid, at.size, at), reverse=True)
        return cls(jnp.maximum(gap_before + 1, first), gap_after - 1, first + count - 1)


class Points(NamedTuple):
    """Weight of windows that start, have their middle (times k as well) or end at each sample."""

    start: Float[Array, " n"]
    middle: Float[Array, " n"]
    middle_by_half: Float[Array, " n"]
    end: Float[Array, " n"]

    @classmethod
    def of_bin(cls, bin_: LagBins, runs: Runs, pieces: int) -> "Points":
        """How many windows of a bin's lengths, `pieces` lags each, have their ends at each sample;
        without weights."""
        at, shortest, longest = jnp.arange(runs.last.shape[0]), bin_.first, bin_.last
        first, last, stop = runs

        def counted(low: Leaf, high: Array) -> Array:
            return jnp.maximum(high - low + 1, 0)

        begins = (at >= first) & (at <= stop) & (at <= last)
        start = counted(shortest, jnp.minimum(longest, (last - at) // pieces))
        least = jnp.maximum(shortest, -(-(at - stop) // pieces))
        end = counted(least, jnp.minimum(longest, (at - first) // pieces))
        middle = by_half = jnp.zeros_like(end)
        if pieces == 2:
            low = jnp.maximum(shortest, at - stop)
            high = jnp.minimum(longest, jnp.minimum(at - first, last - at))
            middle = counted(low, high)
            by_half = middle * (low + high) / 2
        return cls(jnp.where(begins, start, 0), middle, by_half, jnp.where(at <= last, end, 0))


class _Sums(NamedTuple):
    """What a bin of lags adds to the moments.

    **Fields:** `inner`, the sum of phi that multiplies phi at each sample; `squares`, the weight of
    phi phi^T at each sample; `number` of windows, in all or from each start.
    """

    inner: Float[Array, "columns n"]
    squares: Float[Array, " n"]
    number: Float[Array, "*starts"]


Moments = tuple[Float[Array, "blocks columns columns"], Float[Array, " blocks"]]
"""Sums of outer products of rows, and numbers of rows, for blocks of starts."""


def moments_in_blocks(
    primitives: Primitives, lags: LagBins, blocks: StartBlocks, *, reach: int
) -> Moments:
    """Moments M and numbers N of all windows, for blocks of starts.

    **Arguments:** `primitives`, whose differences are the rows; `lags` with two axes give moments
    for each of the first, along a leading axis; `reach`: no window is longer, in samples.
    """
    values, present, size = primitives.values, primitives.present, blocks.size
    if primitives.difference == 1 and present is None and isinstance(size, int) and reach <= size:
        # Shorter blocks lose fewer digits. At four times the reach, the samples beyond a block,
        # which two blocks work through, are still few.
        parts = 1
        while size % (2 * parts) == 0 and size // (2 * parts) >= 4 * reach:
            parts *= 2
        shorter = blocks._replace(size=size // parts, number=blocks.number * parts)
        moments, number = unbroken_boxcar_moments(primitives, lags, shorter, reach)
        apart = (*moments.shape[:-3], blocks.number, parts)
        moments = moments.reshape(*apart, *moments.shape[-2:])
        return jnp.sum(moments, axis=-3), jnp.sum(number.reshape(apart), axis=-1)
    n = values.shape[1]
    valid: Any = both(present, jnp.arange(n) < blocks.unpadded)
    # Of a block of traced size no more is known than that it is shorter than the longest window.
    width = min((size if isinstance(size, int) else reach) + reach, n)

    def of_block(index: Int[Array, ""]) -> tuple[Array, Array]:
        # The last slices would reach beyond the record: they begin earlier instead.
        first = blocks.first + index * size
        begin = jnp.clip(first, 0, n - width)
        part = jax.lax.dynamic_slice_in_dim(values, begin, width, axis=1)
        # With their polynomial put back, less what their differences do not see: the mean for first
        # differences and the straight line of least squares for second ones.
        place = jnp.arange(width) - (width - 1) / 2
        order = primitives.difference
        phi = part + primitives.mean[:, None] * (place**order / order)[None, :]
        phi = phi - jnp.mean(phi, axis=1, keepdims=True)
        if order > 1:
            slope = (phi @ place) / jnp.maximum(jnp.sum(place**2), 1.0)
            phi = phi - slope[:, None] * place[None, :]
        there = jax.lax.dynamic_slice_in_dim(valid, begin, width)
        runs = Runs.of(there, first - begin, size)
        return each_bin(lambda law: window_moments(phi, runs, law, order), lags)

    moments, number = jax.lax.map(of_block, jnp.arange(blocks.number))
    if lags.first.ndim == 1:
        return moments, number
    return jnp.swapaxes(moments, 0, 1), jnp.swapaxes(number, 0, 1)


def unbroken_boxcar_moments(
    primitives: Primitives, lags: LagBins, blocks: StartBlocks, reach: int
) -> Moments:
    """Moments of all boxcar rows, for blocks of starts, where no sample is missing.

    All blocks go side by side, and every sum is a running sum, shifted by one offset for all
    samples, in place of one looked up at limits that differ. M is symmetric, so half of it is
    formed: M = Z + Z^T with Z = sum_u phi[u] ((s[u] + e[u]) / 2 phi[u] - c[u])^T, one product over
    the block's starts, and one over the samples beyond it, where s and c are zero. `reach` is at
    most the blocks' size.
    """
    phi, running = _side_by_side(primitives, blocks, reach)
    block = blocks.size
    assert isinstance(block, int)
    start, end = jnp.arange(block), jnp.arange(block + reach)
    left = blocks.unpadded - blocks.first - block * jnp.arange(blocks.number)[:, None]

    def bin_sums(bin_: LagBins) -> _Sums:
        def shifted(by: Leaf) -> Array:
            return jax.lax.dynamic_slice_in_dim(running, by, block, axis=2)

        lag_count = bin_.last - bin_.first + 1
        number = jnp.clip(left - start[None, :] - bin_.first, 0, lag_count)
        inner = shifted(bin_.last + 1) - shifted(bin_.first)
        earliest = jnp.maximum(end - bin_.last, 0)
        ending = jnp.maximum(jnp.minimum(end - bin_.first, block - 1) - earliest + 1, 0)
        return _Sums(inner, ending, number)

    own, beyond = phi[:, :, :block], phi[:, :, block:]

    def law_moments(law: LagBins) -> Moments:
        total = sum_over_bins(law, bin_sums)
        weight = 0.5 * (total.number + total.squares[None, :block])
        half = products_of_blocks(own, weight[None] * own - total.inner)
        half = half + products_of_blocks(beyond, 0.5 * total.squares[None, None, block:] * beyond)
        return half + jnp.swapaxes(half, 1, 2), jnp.sum(total.number, axis=1)

    return each_bin(law_moments, lags)


def _side_by_side(
    primitives: Primitives, blocks: StartBlocks, reach: int
) -> tuple[Float[Array, "columns blocks reached"], Float[Array, "columns blocks 1+reached"]]:
    """phi of each block and of what its windows reach beyond it, and the running sum S of that.

    phi is referred to the block's mean and zero beyond the record. What lies beyond a block is the
    beginning of the next one, which has another reference: phi there differs by the constant
    `step`, and S by `step` times the number of samples added up.
    """
    values, mean, block, count = primitives.values, primitives.mean, blocks.size, blocks.number
    assert isinstance(block, int)
    parts = blocks.cut(values, count + 1)
    valid = jnp.clip(blocks.unpadded - blocks.first - block * jnp.arange(count + 1), 0, block)
    inside = (jnp.arange(block)[None, :] < valid[:, None])[None]
    place = jnp.arange(block) - (block - 1) / 2
    parts = jnp.where(inside, parts + mean[:, None, None] * place[None, None, :], 0.0)
    reference = jnp.sum(parts, axis=2) / jnp.maximum(valid, 1)[None, :]
    parts = jnp.where(inside, parts - reference[:, :, None], 0.0)
    running = running_sum(parts.reshape(-1, block)).reshape(parts.shape)
    total = running[:, :-1, -1:]
    step = (jnp.diff(reference, axis=1) + block * mean[:, None])[:, :, None]
    further = jnp.where(inside[:, 1:, :reach], parts[:, 1:, :reach] + step, 0.0)
    added = jnp.minimum(jnp.arange(1, reach + 1)[None, :], valid[1:, None])
    beyond = total + running[:, 1:, :reach] + step * added[None]
    running = jnp.concatenate([jnp.zeros_like(total), running[:, :-1], beyond], axis=2)
    return jnp.concatenate([parts[:, :-1], further], axis=2), running


def window_moments(
    phi: Float[Array, "columns n"], runs: Runs, bins: LagBins, difference: int
) -> tuple[Float[Array, "columns columns"], Float[Array, ""]]:
    """Sum of the outer products of all rows, and their number: of boxcars (a first difference of
    phi) or hats (a second one)."""
    at = jnp.arange(phi.shape[1])

    def of_bin(bin_: LagBins) -> _Sums:
        shortest, longest = bin_.first, bin_.last
        points = Points.of_bin(bin_, runs, difference)

        def beyond(count: Array, low: Leaf, high: Array, stride: int = 1) -> Array:
            sums = sum_between(phi, at + stride * low, at + stride * high, stride)
            return jnp.where((count > 0)[None, :], sums, 0.0)

        # From the start t: k up to the longest, with the end inside the run.
        most = jnp.minimum(longest, (runs.last - at) // difference)
        inner = -beyond(points.start, shortest, most)
        if difference == 2:
            # From the middle u: the start u - k and the end u + k in the run, the start in the
            # range.
            low = jnp.maximum(shortest, at - runs.stop)
            high = jnp.minimum(longest, jnp.minimum(runs.last - at, at - runs.first))
            ends = beyond(points.start, shortest, most, stride=2)
            inner = ends + 2 * (inner - beyond(points.middle, low, high))
        squares = points.start + 4 * points.middle + points.end
        # Windows are counted in real numbers: a long record's are more than 32-bit integers hold.
        number = jnp.sum(points.start, dtype=phi.dtype)
        return _Sums(inner, squares.astype(phi.dtype), number)

    total = sum_over_bins(bins, of_bin)
    cross = phi @ total.inner.T
    return (phi * total.squares[None, :]) @ phi.T + cross + cross.T, total.number
