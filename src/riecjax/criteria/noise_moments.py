"""How much noise at each sample weighs in the Gram matrix of all windows: closed forms.

A row is a weighted sum over samples, sum_k sum_u w_k(u) c_k[u], where c_k stands under k
derivatives. White noise that moves c_k by e[u] at sample u, and c_l by f[u], adds

    sum over windows of sum_u w_k(u) w_l(u) e[u] f[u] = sum_u W_kl[u] e[u] f[u]

in expectation, so that W_kl, one number a sample, is all that is needed of the windows.

**Boxcar**, from t to T. w_1 is -1 at t and 1 at T. w_0 is the time step h inside; near its ends it
is that of the quadrature: sigma_j at j samples from t inwards, 1/2 at j = 0, of trapezoids. With
windows of total weight s[u] that start at u and e[u] that end there, and i[u] that cover it,

    W_11 = s + e,    W_01 = h (e - s) / 2,
    W_00 = h^2 (i + sum_j (sigma_j^2 - [j >= 0]) (s[u - j] + e[u + j])).

**Hat**, with its middle m, k samples from either end. w_2 is 1, -2, 1 at t, m, T, and w_1 is h
times -1 to the left of m and 1 to the right. w_0 / h^2 is the triangle k - |u - m|, and at each of
the three points the pattern p that two quadratures in a row leave, times 1, -2, 1. So W_22 = s + 4
m + e with m[u] the windows whose middle is at u; the triangle's squares are sums of (u - t)^2 from
each start on, less 4 k (u - m) from each middle on, less (u - T)^2 from each end on; and k m, the
middles weighed by k, is the only further number needed.

A sample's noise is counted where the sample lies, a window's row where the window starts: blocks of
both add up to the same.
"""

from collections.abc import Callable, Sequence
from itertools import combinations_with_replacement
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from riecjax.criteria.all_windows import Runs
from riecjax.criteria.chunks import StartBlocks
from riecjax.criteria.laws import LagBins, each_bin, sum_over_bins, sum_over_lengths
from riecjax.criteria.quadrature import interval_weights
from riecjax.criteria.windows import WindowSet
from riecjax.equations.noisy_columns import Columns, Movement, NoisyColumns, is_white
from riecjax.leaves import Leaf

NoiseWeights = Float[Array, "orders orders n"]
"""W_kl at every sample, for derivatives k and l that a test function takes off."""


class Points(NamedTuple):
    """Weight of windows that start, have their middle (times k as well) or end at each sample."""

    start: Float[Array, " n"]
    middle: Float[Array, " n"]
    middle_by_half: Float[Array, " n"]
    end: Float[Array, " n"]


def points_of_windows(columns: Columns, lags: LagBins, blocks: StartBlocks, pieces: int) -> Points:
    """Where all windows of a law that start in some blocks have their ends, `pieces` lags long."""
    at, present = jnp.arange(columns.sample_count), columns.present
    if present is None:
        first, last = jnp.zeros_like(at), jnp.broadcast_to(blocks.unpadded - 1, at.shape)
    else:
        first, last = Runs.of(present & (at < blocks.unpadded))
    first = jnp.maximum(first, blocks.first)
    stop = blocks.first + blocks.size * blocks.number - 1

    def counted(low: Leaf, high: Array) -> tuple[Array, Array]:
        number = jnp.maximum(high - low + 1, 0)
        return number, number * (low + high) / 2

    def of_bin(bin_: LagBins) -> Points:
        shortest, longest = bin_.first, bin_.last
        begins = (at >= first) & (at <= stop) & (at <= last)
        start, _ = counted(shortest, jnp.minimum(longest, (last - at) // pieces))
        least = jnp.maximum(shortest, -(-(at - stop) // pieces))
        end, _ = counted(least, jnp.minimum(longest, (at - first) // pieces))
        middle = by_half = jnp.zeros_like(end)
        if pieces == 2:
            room = jnp.minimum(at - first, last - at)
            middle, by_half = counted(jnp.maximum(shortest, at - stop), jnp.minimum(longest, room))
        here = at <= last
        counts = Points(jnp.where(begins, start, 0), middle, by_half, jnp.where(here, end, 0))
        return jax.tree.map(lambda leaf: bin_.weight * leaf, counts)

    return sum_over_bins(lags, of_bin)


def boxcar_noise_weights(points: Points, quadrature: int, step: Leaf) -> NoiseWeights:
    """W_kl of boxcars, k and l of 0 and 1."""
    start, end = points.start, points.end
    inside = _covered(start, end) + _at_ends(start, end, _end_squares(quadrature))
    mixed = 0.5 * step * (end - start)
    return _symmetric([[step**2 * inside, mixed], [mixed, start + end]])


def hat_noise_weights(points: Points, quadrature: int, step: Leaf) -> NoiseWeights:
    """W_kl of hats, k and l of 0 to 2."""
    # Beside each of the three points weights differ from a triangle and its slope, by offsets j.
    start, middle, by_half, end = points
    # p, `twice`: what two running quadratures in a row leave at an end of a triangle, beside the
    # triangle. With z a shift by one sample, a running quadrature is N(z) / (1 - z), where N holds
    # the weights of one interval; a triangle from 0 on is z / (1 - z)^2. So
    # p(z) = (N(z)^2 - z) / (1 - z)^2. The interval that ends at a sample has weights from reach - 1
    # samples after it on, backwards: their product begins at z^(-2 (reach - 1)).
    once = _interval_ends(quadrature)
    first = 2 * (quadrature // 2 - 1)
    weights = interval_weights(quadrature, first // 2)
    product = np.convolve(weights, weights)
    product[1 + first] -= 1.0
    quotient, rest = np.polynomial.polynomial.polydiv(product, [1.0, -2.0, 1.0])
    assert np.allclose(rest, 0.0, atol=1e-12)
    twice = {j - first: float(p) for j, p in enumerate(np.asarray(quotient))}
    ends = {j: (max(j, 0) + twice.get(j, 0.0), once[j]) for j in once}
    triangle = _square_ramp(start) - 4 * _ramp(by_half) - _square_ramp(end)
    ramp = 2 * (jnp.cumsum(by_half) - 0.5 * by_half) - _ramp(start) + _ramp(end)
    flat = _covered(start, end) - middle
    triangle = triangle + _at_ends(
        start, end, {j: w**2 - max(j, 0) ** 2 for j, (w, _) in ends.items()}
    )
    odd = {j: max(j, 0) - w * slope for j, (w, slope) in ends.items()}
    ramp = ramp + _at_ends(start, -end, odd)
    flat = flat + _at_ends(start, end, _end_squares(quadrature))
    for j in once:
        p, turn, sign = twice.get(j, 0.0), once[j] - once[-j], np.sign(j)
        own, halves = _shifted(middle, j), _shifted(by_half, j)
        triangle = triangle - 4 * p * halves + 4 * (p**2 + abs(j) * p) * own
        ramp = ramp + (turn - sign) * halves - (abs(j) * (turn - sign) + 2 * p * turn) * own
        flat = flat + (turn**2 - abs(sign)) * own
    knots = twice[0] * (start + end + 4 * middle) - 2 * by_half
    turn = 0.5 * step * (end - start)
    return _symmetric(
        [
            [step**4 * triangle, step**3 * ramp, step**2 * knots],
            [step**3 * ramp, step**2 * flat, turn],
            [step**2 * knots, turn, start + 4 * middle + end],
        ]
    )


def _symmetric(weights: Sequence[Sequence[Leaf]]) -> NoiseWeights:
    return jnp.stack([jnp.stack([jnp.asarray(w) for w in row]) for row in weights])


def _covered(start: Array, end: Array) -> Array:
    """Windows whose first and last sample a sample lies between, these included."""
    return jnp.cumsum(start) - jnp.cumsum(end) + end


def _ramp(points: Array) -> Array:
    """Sum of points[u] (v - u) over u < v."""
    return _after(jnp.cumsum(jnp.cumsum(points)))


def _square_ramp(points: Array) -> Array:
    """Sum of points[u] (v - u)^2 over u < v: (v - u)^2 is twice C(v - u + 1, 2) less v - u."""
    return 2 * _after(jnp.cumsum(jnp.cumsum(jnp.cumsum(points)))) - _ramp(points)


def _after(values: Array) -> Array:
    return jnp.pad(values, (1, 0))[:-1]


def _shifted(values: Array, by: int) -> Array:
    """values[u - by], zero beyond the ends."""
    n = values.shape[0]
    return jnp.pad(values, (max(by, 0), max(-by, 0)))[max(-by, 0) : max(-by, 0) + n]


def _at_ends(start: Array, end: Array, weights: dict[int, float]) -> Array:
    """What ends of windows add at j samples inwards."""
    return sum(
        (w * (_shifted(start, j) + _shifted(end, -j)) for j, w in weights.items()),
        start=jnp.zeros_like(start),
    )


def _interval_ends(quadrature: int) -> dict[int, float]:
    """sigma_j: weight of the sample j inwards from a window's end, 1 from some j on.

    The sum of what the intervals from the end on give that sample.
    """
    reach = quadrature // 2
    weights = interval_weights(quadrature, reach - 1)
    # Interval i, between samples i and i + 1 from the end, weighs sample j by its weight number
    # j - i + reach - 1.
    return {
        j: float(
            sum(
                weights[j - i + reach - 1]
                for i in range(2 * reach)
                if 0 <= j - i + reach - 1 < quadrature
            )
        )
        for j in range(-reach, reach + 1)
    }


def _end_squares(quadrature: int) -> dict[int, float]:
    return {j: w**2 - (j >= 0) for j, w in _interval_ends(quadrature).items()}


def noise_weights_of_lengths(
    of_length: Callable[[Leaf, Leaf], tuple[Float[Array, " n"], Float[Array, "orders n"]]],
    lengths: tuple[Leaf, Leaf],
) -> NoiseWeights:
    """W_kl[u] = sum over lengths and t of starts[t] w_k[u - t] w_l[u - t], by Fourier transform.

    **Arguments:** `of_length`, of a window's length and its weight in the law, how much windows
    weigh that start at each sample, and the weights w_k inside of them; `lengths` and their weight.
    """
    starts, weights = jax.eval_shape(of_length, *(leaf[0] for leaf in lengths))
    orders, n = weights.shape
    one, other = np.triu_indices(orders)

    def products(length: Leaf, weight: Leaf) -> Array:
        at, inside = of_length(length, weight)
        spectrum = jnp.fft.rfft(inside[one] * inside[other], 2 * n, axis=-1)
        return jnp.fft.rfft(at, 2 * n)[None] * spectrum

    none = jnp.zeros((one.size, n + 1), jnp.result_type(starts.dtype, jnp.complex64))
    found = jnp.fft.irfft(sum_over_lengths(products, lengths, none), 2 * n, axis=-1)[:, :n]
    place = np.zeros((orders, orders), int)
    place[one, other] = place[other, one] = np.arange(one.size)
    return found[place]


# What sensor noise adds to a Gram matrix of rows, in expectation.
#
# Subtracted from it, it leaves what the same windows would say of the signals without noise: a
# model that leaves something out converges to the values that it has without noise, which under
# other weights it does not.
#
# Noise that is white in all signals of an equation needs the weights W_kl of `noise_weights` and
# one weighted product of how columns move. Other noise is sent through the windows: signs at
# random, filtered as the noise is, make columns whose own Gram matrix has the right expectation,
# whatever the windows, gaps and filters are. The mean over `PROBES` of them scatters by less than
# the noise's own products do, and adds to an estimate's variance a `PROBES`-th of what these add.

PROBES = 8
"""Noises that are sent through the windows for each source that is not white."""
SIGNS = np.random.default_rng(7).integers(0, 2, (PROBES, 2**16), np.int8) * 2 - 1


class NoiseMoments(eqx.Module):
    """What noise adds to the sums of outer products of rows.

    **Fields:** `total`, for blocks of starts; `of_source`, what each source adds to all of them,
    in the order of the noise's sources.
    """

    total: Float[Array, "*bins blocks columns columns"]
    of_source: Float[Array, "*bins sources columns columns"]


def noise_moments(
    noisy: NoisyColumns,
    windows: LagBins | WindowSet,
    blocks: StartBlocks,
    weights_of: Callable[[LagBins | WindowSet], NoiseWeights | None],
    products: Callable[[Columns], Float[Array, "*bins blocks columns columns"]],
) -> NoiseMoments:
    """What noise adds to the moments of an equation.

    **Arguments:** `windows`, the law of all that start in the blocks, or those drawn; `weights_of`
    white noise at each sample, without which there is no closed form; `products`, sums of outer
    products of the rows that columns make, for blocks of starts.
    """
    columns, noise = noisy.columns, noisy.noise
    width = columns.values.shape[1]

    def in_closed_form(law: LagBins | WindowSet) -> list[Array] | None:
        """What each white source adds, and at last what is added where columns are curved."""
        if (weights := weights_of(law)) is None:
            return None
        of_white = [
            _weighted(movement, weights, blocks, width) for movement in noisy.white.values()
        ]
        nothing = jnp.zeros((blocks.number, width, width), columns.values.dtype)
        every = (times * _weighted(m, weights, blocks, width) for times, m in noisy.curved)
        return [*of_white, sum(every, start=nothing)]

    closed = None
    if noisy.white or noisy.curved:
        is_law = isinstance(windows, LagBins)
        closed = each_bin(in_closed_form, windows) if is_law else in_closed_form(windows)
    if closed is None:
        white = jnp.ones(1)
        each = [_probed([(m, white)], columns, products) for m in noisy.white.values()]
        every = [times * _probed([(m, white)], columns, products) for times, m in noisy.curved]
        curved = sum(every, start=jnp.zeros(()))
    else:
        *each, curved = closed
    found = dict(zip(noisy.white, each))
    # Kernels of the signals' coloured noise, which has unit size in each.
    coloured: dict[str, list[tuple[Movement, Array]]] = {}
    for name, movement in sorted(noisy.coloured.items()):
        own = {
            s: t for s, t in noise.kernels[name].items() if not is_white(noise, s, noisy.coloured)
        }
        size = jnp.sqrt(sum(jnp.sum(jnp.asarray(t) ** 2) for t in own.values()))
        for source, taps in own.items():
            unit = jnp.asarray(taps) / jnp.where(size > 0, size, 1.0)
            coloured.setdefault(source, []).append((movement, unit))
    for source, parts in sorted(coloured.items()):
        found[source] = _probed(parts, columns, products)
    nothing = jnp.zeros_like(next(iter(found.values())))
    of_source = [jnp.sum(found.get(source, nothing), axis=-3) for source in noise.sources]
    return NoiseMoments(sum(found.values(), start=curved), jnp.stack(of_source, axis=-3))


def _weighted(
    movement: Movement, weights: NoiseWeights, blocks: StartBlocks, size: int
) -> Float[Array, "blocks columns columns"]:
    """sum_u W_kl[u] m_k[u] m_l[u]^T over all orders k and l."""
    orders = weights.shape[0]
    if all(values.shape[1] == 1 for values in movement.values.values()):
        # Of columns that noise moves alike at every sample, as it does linear terms, what they move
        # by stands before the sums, and one product serves all orders.
        still = jnp.zeros((orders, size), weights.dtype)
        for order, values in movement.values.items():
            still = still.at[order, np.array(movement.rows[order])].add(values[:, 0])
        one, other = np.triu_indices(orders)
        unit = jnp.ones((1, 1), weights.dtype)
        pairs = jax.vmap(lambda w: _sums_in_blocks(unit, w, unit, blocks)[:, 0, 0])
        sums = pairs(weights[one, other])
        place = np.zeros((orders, orders), int)
        place[one, other] = place[other, one] = np.arange(one.size)
        return jnp.einsum("klb,ki,lj->bij", sums[place], still, still)
    total = jnp.zeros((blocks.number, size, size), weights.dtype)
    for (k, left), (m, right) in combinations_with_replacement(movement.values.items(), 2):
        rows, columns = np.array(movement.rows[k]), np.array(movement.rows[m])
        part = _sums_in_blocks(left, weights[k, m], right, blocks)
        total = total.at[:, rows[:, None], columns[None, :]].add(part)
        if k != m:
            total = total.at[:, columns[:, None], rows[None, :]].add(jnp.swapaxes(part, 1, 2))
    return total


def _sums_in_blocks(
    left: Float[Array, "a samples"],
    weight: Float[Array, " n"],
    right: Float[Array, "b samples"],
    blocks: StartBlocks,
) -> Float[Array, "blocks a b"]:
    """sum_u weight[u] left[u] right[u]^T by blocks; what lies beyond counts to the last one."""
    number, size, n = blocks.number, blocks.size, weight.shape[0]
    still = left.shape[1] == right.shape[1] == 1
    if not isinstance(size, int):
        block = jnp.clip((jnp.arange(n) - blocks.first) // size, 0, number - 1)
        if still:
            sums = jax.ops.segment_sum(weight, block, num_segments=number)
            return sums[:, None, None] * (left @ right.T)[None]
        other = jnp.broadcast_to(right, (right.shape[0], n)).T
        each = (weight[None] * left).T[:, :, None] * other[:, None]
        return jax.ops.segment_sum(each, block, num_segments=number)
    # As many blocks of the same size as the samples could fill, the first sample in the first one.
    room = max(-(-n // size), number)

    def apart(values: Array) -> Array:
        padded = jnp.pad(values, ((0, 0), (0, room * size)))
        part = jax.lax.dynamic_slice_in_dim(padded, blocks.first, room * size, axis=1)
        return part.reshape(values.shape[0], room, size)

    weights = apart(weight[None])[0]
    if still:
        sums = jnp.sum(weights, axis=1)[:, None, None] * (left @ right.T)[None]
    else:
        varying = [
            values[:, :, None] if values.shape[1] == 1 else apart(values)
            for values in (left, right)
        ]
        sums = jnp.einsum(
            "abu,cbu->bac",
            weights[None] * varying[0],
            jnp.broadcast_to(varying[1], (right.shape[0], room, size)),
            precision=jax.lax.Precision.HIGHEST,
        )
    return sums[:number].at[-1].add(jnp.sum(sums[number:], axis=0))


def _probed(
    parts: Sequence[tuple[Movement, Array]],
    like: Columns,
    products: Callable[[Columns], Float[Array, "*bins blocks columns columns"]],
) -> Float[Array, "*bins blocks columns columns"]:
    """Mean of the products of rows of what a source's noise, sent through, makes of columns.

    **Arguments:** `parts`, how columns move with each signal, and the source's kernel in it.
    """
    n, reach = like.sample_count, max(taps.shape[-1] // 2 for _, taps in parts)

    def once(signs: Array) -> Array:
        values = jnp.zeros_like(like.values)
        for movement, taps in parts:
            # White noise, which begins `reach` samples earlier, through the kernel.
            size = signs.shape[0] + taps.shape[-1]
            white = jnp.fft.rfft(signs.astype(values.dtype), size)
            first = reach + taps.shape[-1] // 2
            noise = jnp.fft.irfft(white * jnp.fft.rfft(taps, size), size)[first : first + n]
            values = values + movement.times(noise, like)
        return products(eqx.tree_at(lambda columns: columns.values, like, values))

    place = np.arange(n + 2 * reach) % SIGNS.shape[1]
    return jnp.mean(jax.lax.map(once, jnp.asarray(SIGNS[:, place])), axis=0)
