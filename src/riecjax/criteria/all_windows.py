"""Normal equations of all windows in closed form: O(N p^2), however many windows there are.

**The sum.** phi[t] holds the primitives of an equation's 1 + p columns at sample t, the target
first. A window that starts at t with lag k has the row d = phi[t + k] - phi[t] (boxcar), or
phi[t + 2 k] - 2 phi[t + k] + phi[t] (hat, 2 k samples long). For each block B of starts, and some
lags, the normal equations need

    M = sum_{t in B} sum_k d d^T,    N = sum_{t in B} sum_k 1

over the windows that end within the record and hold no missing sample. One by one that costs
O(N K p^2) for K lags.

**Boxcar.** Let s[u] windows start at sample u and e[u] windows end there. Multiplied out, the
squares depend on these numbers alone, and the mixed products on one sum:

    M = sum_u (s[u] + e[u]) phi[u] phi[u]^T - X - X^T,
    X = sum_t phi[t] c[t]^T,    c[t] = sum_k phi[t + k]

Over lags from a to b (a bin) c[t] is one difference of the running sum S[u] = sum_{v < u} phi[v],
and so are s and e of the running count R of starts:

    c[t] = S[t + b + 1] - S[t + a]
    s[t] = b - a + 1,    e[u] = R[u - a + 1] - R[u - b]

A bin costs O(N p). The bins' s, e and c are added up before the one product of O(N p^2).

**Hat.** With m[u] the number of windows whose middle is at u, likewise

    M = sum_u (s[u] + 4 m[u] + e[u]) phi[u] phi[u]^T + Y + Y^T,
    Y = sum_t phi[t] (sum_k (phi[t + 2 k] - 2 phi[t + k]))^T
        - 2 sum_u phi[u] (sum_k phi[u + k])^T

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

import dataclasses
from functools import lru_cache
from typing import NamedTuple

import jax
import numpy as np
from jaxtyping import Bool, Float, Int

from riecjax import arrays as xp
from riecjax.arrays import Array
from riecjax.criteria.windows import LagBins, StartBlocks, sum_over_bins
from riecjax.leaves import Leaf

ROW = 16
"""Samples to a row: so many products each costs, and one sixteenth is left to sum over rows."""
TRIANGLE = np.triu(np.ones((ROW, ROW)))


def running_sum(values: Float[Array, "*columns n"]) -> Float[Array, "*columns n"]:
    """Sum of the samples up to each, itself included."""
    return _by_rows(values) if xp.is_traced(values) else np.cumsum(values, axis=-1)


@jax.jit  # is called dozens of times in one trace, of few shapes
def _by_rows(values: Float[Array, "*columns n"]) -> Float[Array, "*columns n"]:
    """By rows of 16 samples, each times a triangle of ones, and then over the rows' totals.

    A compiled matrix product is many times faster than a scan, and sums of sums round as log n.
    """
    *columns, n = values.shape
    if n <= 2 * ROW:
        return xp.cumsum(values, axis=-1)
    rows = -(-n // ROW)
    padded = xp.pad(values, [(0, 0)] * len(columns) + [(0, rows * ROW - n)])
    triangle = TRIANGLE.astype(values.dtype)
    # Accelerators would otherwise multiply 32-bit numbers with ten bits.
    within = xp.matmul(
        padded.reshape(-1, ROW), triangle, precision=jax.lax.Precision.HIGHEST
    ).reshape(*columns, rows, ROW)
    totals = within[..., -1]
    before = _by_rows(totals) - totals
    return (within + before[..., None]).reshape(*columns, rows * ROW)[..., :n]


ORDERS = (2, 4, 6, 8)


def running_integral(
    samples: Float[Array, "columns n"], order: int = 2, present: Bool[Array, " n"] | None = None
) -> Float[Array, "columns n"]:
    """Integral from the first sample to each, in units of the time step.

    An interval whose polynomial would reach over a missing sample takes the trapezoid instead.
    """
    n = samples.shape[1]
    order = min(order, 2 * (n // 2))
    areas = [0.5 * (samples[:, 1:] + samples[:, :-1])] if order == 2 or present is not None else []
    if order > 2:
        # Of the polynomial centred on each interval; at either end of one for several.
        reach, inner = order // 2 - 1, n - order + 1
        weights = interval_weights(order, reach)
        # The weights are the same from either end.
        outermost, *others = (
            float(w) * (samples[:, j : j + inner] + samples[:, order - 1 - j : n - j])
            for j, w in enumerate(weights[: order // 2])
        )
        middle = sum(others, start=outermost)
        first, last = (
            xp.stack([ends @ interval_weights(order, at) for at in places], 1)
            for ends, places in (
                (samples[:, :order], range(reach)),
                (samples[:, n - order :], range(order - 1 - reach, order - 1)),
            )
        )
        higher = [first, middle, last]
        if present is not None:  # where every sample of an interval's polynomial is present
            absent = xp.pad(xp.cumsum(~present), (1, 0))
            first = np.clip(np.arange(n - 1) - (order // 2 - 1), 0, n - order)
            whole = (absent[first + order] == absent[first])[None, :]
            higher = [xp.where(whole, xp.concatenate(higher, axis=1), areas[0])]
        areas = higher
    return running_sum(xp.concatenate([xp.zeros_like(samples[:, :1]), *areas], axis=1))


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


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True, eq=False)
class Primitives:
    """For each column of an equation, the function whose s-th differences are its integrals.

    **Fields:**

    - `values`: the s-th running integral of the column less its mean, shape `(columns, n)`.
    - `mean`: the mean times the time step to the power s, shape `(columns,)`.
    - `slope` of the primitive, the column over a sample.
    - `present`: where every column has its sample and the equation is to be trusted; `None`
      where that is everywhere.
    - `difference`: s, 1 for the boxcar and 2 for the hat.
    """

    values: Float[Array, "columns n"]
    mean: Float[Array, " columns"]
    slope: Float[Array, "columns n"]
    present: Bool[Array, " n"] | None
    difference: int = dataclasses.field(metadata={"static": True})

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
        if np.issubdtype(position.dtype, np.integer):
            return xp.take(self.values, position, axis=1)
        # Between samples the integrand is the straight line s_i + x (s_i+1 - s_i), 0 <= x <= 1, so
        # its primitive is F_i + x (F_i+1 - F_i) - x (1 - x) / 2 (s_i+1 - s_i).
        below = xp.clip(position.astype(np.int32), 0, self.values.shape[1] - 2)
        share = (position - below)[None, :]
        left, right, from_, to = (
            xp.take(each, at, axis=1)
            for each in (self.values, self.slope)
            for at in (below, below + 1)
        )
        return left + share * (right - left) - 0.5 * share * (1 - share) * (to - from_)


class Runs(NamedTuple):
    """Runs of valid samples, and the starts of windows in them.

    **Fields:** `first`, for each sample where the first window starts that may hold it; `last`
    sample of the run it lies in; `stop`, where the last window of all starts.
    """

    first: Int[Array, "*blocks n"]
    last: Int[Array, "*blocks n"]
    stop: Int[Array, ""] | int

    @classmethod
    def of(cls, valid: Bool[Array, "*blocks n"], first: Int[Array, ""] | int, count: int) -> "Runs":
        """Of a mask, and so many starts from the `first` on."""
        at = _places(valid)
        gap_before = xp.running_max(xp.where(valid, -1, at))
        gap_after = -xp.running_max(-xp.where(valid, at.size, at), reverse=True)
        return cls(xp.maximum(gap_before + 1, first), gap_after - 1, first + count - 1)


def _places(like: Array) -> Int[np.ndarray, "*blocks n"]:
    """The number of each sample, along the last axis of as many as those of an array."""
    return np.arange(like.shape[-1]).reshape((1,) * (like.ndim - 1) + (-1,))


class Points(NamedTuple):
    """Windows that start, have their middle (times k as well) or end at each sample."""

    start: Float[Array, "*blocks n"]
    middle: Float[Array, "*blocks n"]
    middle_by_half: Float[Array, "*blocks n"]
    end: Float[Array, "*blocks n"]

    @classmethod
    def of_bin(cls, bin_: LagBins, runs: Runs, pieces: int) -> "Points":
        """How many windows of a bin's lengths, `pieces` lags each, have an end at each sample."""
        at, shortest, longest = _places(runs.last), bin_.first, bin_.last
        first, last, stop = runs

        def counted(low: Leaf, high: Array) -> Array:
            return xp.maximum(high - low + 1, 0)

        begins = (at >= first) & (at <= stop) & (at <= last)
        start = counted(shortest, xp.minimum(longest, (last - at) // pieces))
        least = xp.maximum(shortest, -((stop - at) // pieces))
        end = counted(least, xp.minimum(longest, (at - first) // pieces))
        middle = by_half = np.zeros((1,) * last.ndim)
        if pieces == 2:
            low = xp.maximum(shortest, at - stop)
            high = xp.minimum(longest, xp.minimum(at - first, last - at))
            middle = counted(low, high)
            by_half = middle * (low + high) / 2
        return cls(xp.where(begins, start, 0), middle, by_half, xp.where(at <= last, end, 0))


Moments = tuple[Float[Array, "blocks columns columns"], Float[Array, " blocks"]]
"""Sums of outer products of rows, and numbers of rows, for blocks of starts."""


def moments_in_blocks(
    primitives: Primitives, lags: LagBins, blocks: StartBlocks, *, reach: int
) -> Moments:
    """Moments M and numbers N of all windows, for blocks of starts.

    **Arguments:** `primitives`, whose differences are the rows; `lags` with two axes give moments
    for each of the first, along a leading axis; `reach`: no window is longer, in samples.
    """
    of_all = _boxcars if primitives.difference == 1 else _hats
    return of_all(primitives, lags, blocks, reach)


def _referred(
    primitives: Primitives, blocks: StartBlocks, reach: int
) -> tuple[Float[Array, "blocks columns n"], Bool[Array, "blocks n"]]:
    """phi of each block and of what its windows reach beyond it, zero beyond the record, and where
    it is valid.

    The polynomial is put back, less what differences do not see: the mean for first differences
    and the straight line of least squares for second ones.
    """
    values, order = primitives.values, primitives.difference
    n, width = values.shape[1], blocks.size + reach
    place = np.arange(width) - (width - 1) / 2
    left = n - blocks.first - blocks.size * np.arange(blocks.number)
    inside = np.arange(width)[None] < left[:, None]
    place, inside = place.astype(values.dtype)[None, None], inside[:, None, :]
    phi = blocks.cut(values, width) + primitives.mean[None, :, None] * (place**order / order)
    count = xp.maximum(inside.sum(axis=-1, keepdims=True), 1)

    def mean(of: Array) -> Array:
        return xp.where(inside, of, 0.0).sum(axis=-1, keepdims=True) / count

    phi = phi - mean(phi)
    if order > 1:
        along = place - mean(place)
        steep = mean(along**2)
        phi = phi - mean(phi * along) / xp.where(steep > 0, steep, 1.0) * along
    valid = inside[:, 0]
    if primitives.present is not None:
        valid = valid & blocks.cut(primitives.present[None], width)[:, 0]
    return xp.where(inside, phi, 0.0), valid


def _boxcars(primitives: Primitives, lags: LagBins, blocks: StartBlocks, reach: int) -> Moments:
    """Moments of all first differences of phi.

    Running sums go over pieces of four times the reach: what two of them work through is little
    then, and they lose few digits. Where no sample is missing every sum is a running sum, shifted
    by one offset for all samples, in place of one looked up at limits that differ. M is symmetric,
    so half of it is formed: M = Z + Z^T with Z = sum_u phi[u] ((s[u] + e[u]) / 2 phi[u] - c[u])^T,
    one product over a block's starts, and one over the samples beyond it, where s and c are zero.
    """
    size, number = blocks.size, blocks.number
    # Blocks to a piece, or pieces to a block.
    several, parts = 1, 1
    while several * size < 4 * reach and several < number:
        several *= 2
    while size % (2 * parts) == 0 and size // (2 * parts) >= 4 * reach:
        parts *= 2
    size, count = size // parts, -(-number * parts // several)
    pieces = StartBlocks(blocks.first, several * size, count)
    phi, valid = _referred(primitives, pieces, reach)
    columns, starts, end = phi.shape[1], several * size, np.arange(size + reach)[None, None]
    running, start = running_sum(phi), np.arange(starts)[None]
    edges = range(0, starts, size)

    def by_block(values: Array) -> Array:
        return values.reshape(count, -1, several, size)

    own = by_block(phi[..., :starts])
    beyond = xp.stack([phi[..., at + size : at + size + reach] for at in edges], axis=1)
    # The last sample that a window may reach from each start, and for each sample, by blocks, the
    # first start in its run.
    last, first = valid.sum(axis=-1)[:, None] - 1, np.zeros((1, 1, 1), int)
    is_broken = primitives.present is not None
    if is_broken:
        runs = Runs.of(valid, 0, starts)
        last = runs.last[:, :starts]
        first = xp.stack([runs.first[:, at : at + size + reach] - at for at in edges], axis=1)

    def of_bin(bin_: LagBins) -> tuple[Array, Array, Array]:
        """-c and s from each start on, and e at each sample of a block."""
        before, longest = bin_.first - 1, bin_.last
        if is_broken:
            high = xp.minimum(start + longest, xp.maximum(last, start + before))
            high = xp.broadcast_to(high[:, None], (count, columns, starts))
            upper = xp.take_along_axis(running, high, axis=-1)
        else:
            upper = xp.cut(running, longest, starts)
        starting = xp.clip(last - start - before, 0, longest - before)
        latest = xp.minimum(end - bin_.first, size - 1)
        ending = xp.maximum(latest - xp.maximum(end - longest, xp.maximum(first, 0)) + 1, 0)
        inner = xp.cut(running, before, starts) - upper
        return inner, starting.astype(phi.dtype), ending.astype(phi.dtype)

    def summed(found: tuple[Array, Array, Array]) -> Moments:
        inner, starting, ending = found
        half, starting = 0.5 * ending[:, :, None], by_block(starting)
        mine, here = (xp.swapaxes(of, 1, 2) for of in (own, 0.5 * starting * own + by_block(inner)))
        z = xp.products(mine, here + half[..., :size] * mine)
        z = z + xp.products(beyond, half[..., size:] * beyond)
        z = z.reshape(-1, columns, columns)[: number * parts]
        moments = (z + xp.swapaxes(z, 1, 2)).reshape(number, parts, columns, columns)
        each = starting.sum(axis=(1, 3)).ravel()[: number * parts].reshape(number, parts)
        return moments.sum(axis=1), each.sum(axis=1)

    return sum_over_bins(lags, of_bin, summed, beside=phi)


def _hats(primitives: Primitives, lags: LagBins, blocks: StartBlocks, reach: int) -> Moments:
    """Moments of all second differences of phi."""
    phi, valid = _referred(primitives, blocks, reach)
    runs, size, at = Runs.of(valid, 0, blocks.size), blocks.size, np.arange(phi.shape[-1])[None]
    once = xp.pad(running_sum(phi), ((0, 0), (0, 0), (1, 0)))
    # S[i] = phi[i - 2] + phi[i - 4] + ...
    pairs = xp.pad(phi, ((0, 0), (0, 0), (2, -at.size % 2)))
    twice = xp.cumsum(pairs.reshape(*phi.shape[:2], -1, 2), axis=2)
    twice = twice.reshape(*phi.shape[:2], -1)[..., : at.size + 2]

    def between(running: Array, low: Array, high: Array, stride: int) -> Array:
        """Sum of phi at `low`, `low + stride`, ... `high`; zero where `high` lies before."""
        edge = running.shape[-1] - 1
        low = xp.clip(low, 0, edge)
        high = xp.clip(xp.maximum(high + stride, low), 0, edge)
        low, high = (xp.broadcast_to(i, (phi.shape[0], low.shape[-1])) for i in (low, high))
        first, last = (xp.take_along_axis(running, i[:, None], axis=-1) for i in (low, high))
        return last - first

    def of_bin(bin_: LagBins) -> tuple[Array, Array, Array, Array]:
        """What multiplies phi at each start and at each middle, the weight of phi phi^T at each
        sample, and the number of windows."""
        shortest, longest = bin_.first, bin_.last
        points = Points.of_bin(bin_, runs, 2)
        # From the start t: k up to the longest, with the end inside the run.
        start, last = at[:, :size], runs.last[:, :size]
        most = xp.minimum(longest, (last - start) // 2)
        inner = between(twice, start + 2 * shortest, start + 2 * most, 2)
        inner = inner - 2 * between(once, start + shortest, start + most, 1)
        inner = xp.where((points.start[:, :size] > 0)[:, None], inner, 0.0)
        # From the middle u: the start u - k and the end u + k in the run, the start in the range.
        low = xp.maximum(shortest, at - runs.stop)
        high = xp.minimum(longest, xp.minimum(runs.last - at, at - runs.first))
        around = -2 * between(once, at + low, at + high, 1)
        around = xp.where((points.middle > 0)[:, None], around, 0.0)
        squares = points.start + 4 * points.middle + points.end
        # Windows are counted in real numbers: a long record's are more than 32-bit integers hold.
        number = points.start.astype(phi.dtype).sum(axis=-1)
        return inner, around, squares.astype(phi.dtype), number

    def summed(found: tuple[Array, Array, Array, Array]) -> Moments:
        inner, around, squares, number = found
        z = xp.products(phi, 0.5 * squares[:, None] * phi + around)
        z = z + xp.products(phi[..., :size], inner)
        return z + xp.swapaxes(z, 1, 2), number

    return sum_over_bins(lags, of_bin, summed, beside=phi)
