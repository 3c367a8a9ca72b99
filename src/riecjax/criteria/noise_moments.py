"""How much noise at each sample weighs in the Gram matrix of all windows: closed forms.

A row is a weighted sum over samples, sum_k sum_u w_k(u) c_k[u], where c_k stands under k
derivatives. White noise that moves c_k by e[u] at sample u, and c_l by f[u], adds

    sum over windows of sum_u w_k(u) w_l(u) e[u] f[u] = sum_u W_kl[u] e[u] f[u]

in expectation, so that W_kl, one number a sample, is all that is needed of the windows.

**Boxcar**, from t to T. w_1 is -1 at t and 1 at T. w_0 is the time step h inside; near its ends it
is that of the quadrature: sigma_j at j samples from t inwards, 1/2 at j = 0, of trapezoids. With
s[u] windows that start at u and e[u] that end there, and i[u] that cover it,

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

import dataclasses
from collections.abc import Callable, Sequence
from itertools import combinations_with_replacement

import numpy as np
from jaxtyping import Float

from riecjax import arrays as xp
from riecjax.arrays import Array
from riecjax.criteria.all_windows import Points, running_integral
from riecjax.criteria.windows import StartBlocks
from riecjax.equations.noisy_columns import Columns, Movement, NoisyColumns, is_white
from riecjax.leaves import Leaf

NoiseWeights = Float[Array, "*bins orders orders n"]
"""W_kl at every sample, for derivatives k and l that a test function takes off."""


def boxcar_noise_weights(points: Points, quadrature: int, step: Leaf) -> NoiseWeights:
    """W_kl of boxcars, k and l of 0 and 1."""
    start, end = points.start, points.end
    inside = _covered(start, end) + _at_ends(start, end, _end_squares(quadrature))
    mixed = 0.5 * step * (end - start)
    return _square(((step**2 * inside, mixed), (mixed, start + end)))


def hat_noise_weights(points: Points, quadrature: int, step: Leaf) -> NoiseWeights:
    """W_kl of hats, k and l of 0 to 2."""
    # Beside each of the three points weights differ from a triangle and its slope, by offsets j.
    start, middle, by_half, end = points
    once, twice = (_left_by_pulse(quadrature, times) for times in (1, 2))
    ends = {j: (twice[j], once[j]) for j in once}
    triangle = _square_ramp(start) - 4 * _ramp(by_half) - _square_ramp(end)
    ramp = 2 * (xp.cumsum(by_half, axis=-1) - 0.5 * by_half) - _ramp(start) + _ramp(end)
    flat = _covered(start, end) - middle
    triangle = triangle + _at_ends(
        start, end, {j: w**2 - max(j, 0) ** 2 for j, (w, _) in ends.items()}
    )
    odd = {j: max(j, 0) - w * slope for j, (w, slope) in ends.items()}
    ramp = ramp + _at_ends(start, -end, odd)
    flat = flat + _at_ends(start, end, _end_squares(quadrature))
    for j in once:
        p, turn, sign = twice[j] - max(j, 0), once[j] - once[-j], np.sign(j)
        own, halves = _shifted(middle, j), _shifted(by_half, j)
        triangle = triangle - 4 * p * halves + 4 * (p**2 + abs(j) * p) * own
        ramp = ramp + (turn - sign) * halves - (abs(j) * (turn - sign) + 2 * p * turn) * own
        flat = flat + (turn**2 - abs(sign)) * own
    knots = twice[0] * (start + end + 4 * middle) - 2 * by_half
    turn = 0.5 * step * (end - start)
    return _square(
        (
            (step**4 * triangle, step**3 * ramp, step**2 * knots),
            (step**3 * ramp, step**2 * flat, turn),
            (step**2 * knots, turn, start + 4 * middle + end),
        )
    )


def _square(rows: Sequence[Sequence[Float[Array, "*bins n"]]]) -> NoiseWeights:
    return xp.stack([xp.stack(row, axis=-2) for row in rows], axis=-3)


def _covered(start: Array, end: Array) -> Array:
    """Windows whose first and last sample a sample lies between, these included."""
    return xp.cumsum(start, axis=-1) - xp.cumsum(end, axis=-1) + end


def _ramp(points: Array) -> Array:
    """Sum of points[u] (v - u) over u < v: running sums of running sums."""
    return _shifted(xp.cumsum(xp.cumsum(points, axis=-1), axis=-1), 1)


def _square_ramp(points: Array) -> Array:
    """Sum of points[u] (v - u)^2 over u < v: (v - u)^2 is twice C(v - u + 1, 2) less v - u."""
    ramp = _ramp(points)
    return 2 * xp.cumsum(ramp, axis=-1) - ramp


def _shifted(values: Array, by: int) -> Array:
    """values[u - by], zero beyond the ends."""
    if not by:
        return values
    nothing = xp.zeros_like(values[..., : abs(by)])
    parts = (nothing, values[..., :-by]) if by > 0 else (values[..., -by:], nothing)
    return xp.concatenate(parts, axis=-1)


def _at_ends(start: Array, end: Array, weights: dict[int, float]) -> Array:
    """What ends of windows add at j samples inwards."""
    return sum(
        (w * (_shifted(start, j) + _shifted(end, -j)) for j, w in weights.items()),
        start=xp.zeros_like(start),
    )


def _left_by_pulse(quadrature: int, times: int) -> dict[int, float]:
    """What so many running quadratures in a row leave of a pulse, at j samples after it: once, the
    weight sigma_j of the sample j inwards from a window's end, and twice, that of a ramp.

    Beyond these j they are those of exact integrals, 0 or 1, and 0 or j.
    """
    far = max(quadrature - 2, 0)
    left = np.zeros((1, 4 * quadrature + 1))
    left[0, 2 * quadrature] = 1.0
    for _ in range(times):
        left = running_integral(left, quadrature)
    around = left[0, 2 * quadrature - far : 2 * quadrature + far + 1]
    return dict(zip(range(-far, far + 1), around.tolist()))


def _end_squares(quadrature: int) -> dict[int, float]:
    return {j: w**2 - (j >= 0) for j, w in _left_by_pulse(quadrature, 1).items()}


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


def noise_moments(
    noisy: NoisyColumns,
    blocks: StartBlocks,
    white_weights: Callable[[], NoiseWeights | None],
    products: Callable[[Columns], Float[Array, "*bins blocks columns columns"]],
) -> (
    tuple[
        Float[Array, "*bins blocks columns columns"], Float[Array, "*bins sources columns columns"]
    ]
    | None
):
    """What noise adds to the moments of an equation, and what each of its sources adds to those of
    all blocks; `None` without any.

    **Arguments:** `white_weights`, of white noise at each sample, if there is a closed form;
    `products`, sums of outer products of the rows that columns make, for blocks of starts.
    """
    if not (noisy.white or noisy.coloured):
        return None
    columns, noise = noisy.columns, noisy.noise
    width = columns.values.shape[1]

    # What is white, and at last what is added where columns are curved.
    squares = [*((1.0, movement) for movement in noisy.white.values()), *noisy.curved]
    weights = white_weights() if squares else None
    if weights is None:
        unit = np.ones(1)
        added = [times * _probed([(m, unit)], columns, products) for times, m in squares]
    else:
        added = [times * _weighted(m, weights, blocks, width) for times, m in squares]
    found = dict(zip(noisy.white, added))
    curved = sum(added[len(found) :], start=np.zeros(()))
    # Kernels of the signals' coloured noise, which has unit size in each.
    coloured: dict[str, list[tuple[Movement, Array]]] = {}
    for name, movement in sorted(noisy.coloured.items()):
        own = {
            s: t for s, t in noise.kernels[name].items() if not is_white(noise, s, noisy.coloured)
        }
        size = xp.sqrt(sum(xp.square(t).sum() for t in own.values()))
        for source, taps in own.items():
            unit = taps / xp.where(size > 0, size, 1.0)
            coloured.setdefault(source, []).append((movement, unit))
    for source, parts in sorted(coloured.items()):
        found[source] = _probed(parts, columns, products)
    nothing = xp.zeros_like(next(iter(found.values())))
    of_source = [found.get(source, nothing).sum(axis=-3) for source in noise.sources]
    return sum(found.values(), start=curved), xp.stack(of_source, axis=-3)


def _weighted(
    movement: Movement, weights: NoiseWeights, blocks: StartBlocks, size: int
) -> Float[Array, "*bins blocks columns columns"]:
    """sum_u W_kl[u] m_k[u] m_l[u]^T over all orders k and l."""
    *bins, _, _, n = weights.shape
    total = np.zeros((*bins, blocks.number, size, size), weights.dtype)

    def products(left: Array, right: Array) -> Array:
        """By blocks, all bins side by side."""
        rows = left.shape[-2]
        part = blocks.products(left.reshape(-1, n), right)
        part = part.reshape(blocks.number, *bins, rows, right.shape[0])
        return xp.moveaxis(part, 0, -3)

    for (k, left), (m, right) in combinations_with_replacement(movement.values.items(), 2):
        one, other = np.array(movement.rows[k]), np.array(movement.rows[m])
        left = xp.broadcast_to(left, (*bins, len(one), n))
        right = xp.broadcast_to(right, (len(other), n))
        part = products(weights[..., k, m, None, :] * left, right)
        place = (..., one[:, None], other[None, :])
        total = xp.with_entries(total, place, total[place] + part)
        if k != m:
            place = (..., other[:, None], one[None, :])
            total = xp.with_entries(total, place, total[place] + xp.swapaxes(part, -1, -2))
    return total


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
        values = xp.zeros_like(like.values)
        for movement, taps in parts:
            # White noise, which begins `reach` samples earlier, through the kernel.
            size = xp.fft_size(signs.shape[0] + taps.shape[-1])
            white = xp.fft.rfft(signs.astype(values.dtype), size)
            first = reach + taps.shape[-1] // 2
            noise = xp.fft.irfft(white * xp.fft.rfft(taps, size), size)[first : first + n]
            values = values + movement.times(noise, like)
        return products(dataclasses.replace(like, values=values))

    place = np.arange(n + 2 * reach) % SIGNS.shape[1]
    return xp.each(once, SIGNS[:, place], beside=(parts, like)).mean(axis=0)
