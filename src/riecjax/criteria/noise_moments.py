"""What sensor noise adds to a Gram matrix of rows, in expectation.

Subtracted from it, it leaves what the same windows would say of the signals without noise: a model
that leaves something out converges to the values that it has without noise, which under other
weights it does not.

Noise that is white in all signals of an equation needs the weights W_kl of `noise_weights` and one
weighted product of how columns move. Other noise is sent through the windows: signs at random,
filtered as the noise is, make columns whose own Gram matrix has the right expectation, whatever the
windows, gaps and filters are. The mean over `PROBES` of them scatters by less than the noise's own
products do, and adds to an estimate's variance a `PROBES`-th of what these add.
"""

from collections.abc import Callable
from itertools import combinations_with_replacement

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from riecjax.criteria.chunks import StartBlocks
from riecjax.criteria.noise_weights import NoiseWeights
from riecjax.equations.noisy_columns import Columns, Movement, NoisyColumns, is_white
from riecjax.records.noise import Noise

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
    noise: Noise,
    white: Callable[[], list[Array] | None],
    products: Callable[[Columns], Float[Array, "*bins blocks columns columns"]],
) -> NoiseMoments:
    """What noise adds to the moments of an equation.

    **Arguments:** `white` gives what [`in_closed_form`][] does; `products`, sums of outer products
    of the rows that columns make, for blocks of starts.
    """
    closed = white() if noisy.white or noisy.curved else None
    if closed is None:
        *each, curved = _by_probes(noisy, products)
    else:
        *each, curved = closed
    found = dict(zip(noisy.white, each))
    kernels = _coloured_kernels(noise, list(noisy.coloured))
    for source in sorted({source for taps in kernels.values() for source in taps}):
        found[source] = _probed(noisy.coloured, kernels, source, noisy.columns, products)
    nothing = jnp.zeros_like(next(iter(found.values())))
    of_source = [jnp.sum(found.get(source, nothing), axis=-3) for source in noise.sources]
    return NoiseMoments(sum(found.values(), start=curved), jnp.stack(of_source, axis=-3))


def in_closed_form(
    noisy: NoisyColumns, weights: NoiseWeights | None, blocks: StartBlocks
) -> list[Float[Array, "blocks columns columns"]] | None:
    """What each white source adds, and at last what is added where columns are curved.

    **Arguments:** `weights` of white noise at each sample; without them there is no closed form.
    """
    if weights is None:
        return None
    size = noisy.columns.values.shape[1]
    found = [_weighted(movement, weights, blocks, size) for movement in noisy.white.values()]
    nothing = jnp.zeros((blocks.number, size, size), noisy.columns.values.dtype)
    curved = (times * _weighted(m, weights, blocks, size) for times, m in noisy.curved)
    return [*found, sum(curved, start=nothing)]


def _by_probes(
    noisy: NoisyColumns, products: Callable[[Columns], Float[Array, "*bins blocks columns columns"]]
) -> list[Float[Array, "*bins blocks columns columns"]]:
    """The same without a closed form."""
    taps = {"": {"": jnp.ones(1)}}

    def probed(movement: Movement) -> Array:
        return _probed({"": movement}, taps, "", noisy.columns, products)

    found = [probed(movement) for movement in noisy.white.values()]
    curved = [times * probed(movement) for times, movement in noisy.curved]
    return [*found, sum(curved, start=jnp.zeros(()))]


def _coloured_kernels(noise: Noise, read: list[str]) -> dict[str, dict[str, Array]]:
    """Kernels of the signals' coloured noise, which has unit size in each."""
    found = {}
    for name in read:
        taps = {s: t for s, t in noise.kernels[name].items() if not is_white(noise, s, read)}
        size = jnp.sqrt(sum(jnp.sum(jnp.asarray(t) ** 2) for t in taps.values()))
        found[name] = {s: t / jnp.where(size > 0, size, 1.0) for s, t in taps.items()}
    return found


def _weighted(
    movement: Movement, weights: NoiseWeights, blocks: StartBlocks, size: int
) -> Float[Array, "blocks columns columns"]:
    """sum_u W_kl[u] m_k[u] m_l[u]^T over all orders k and l."""
    if all(values.shape[1] == 1 for values in movement.values.values()):
        return _weighted_still(movement, weights, blocks, size)
    total = jnp.zeros((blocks.number, size, size), weights.dtype)
    for (k, left), (m, right) in combinations_with_replacement(movement.values.items(), 2):
        rows, columns = np.array(movement.rows[k]), np.array(movement.rows[m])
        part = _sums_in_blocks(left, weights[k, m], right, blocks)
        total = total.at[:, rows[:, None], columns[None, :]].add(part)
        if k != m:
            total = total.at[:, columns[:, None], rows[None, :]].add(jnp.swapaxes(part, 1, 2))
    return total


def _weighted_still(
    movement: Movement, weights: NoiseWeights, blocks: StartBlocks, size: int
) -> Float[Array, "blocks columns columns"]:
    """The same of columns that noise moves alike at every sample, as it does linear terms.

    What they move by then stands before the sums, and one product serves all orders.
    """
    orders = weights.shape[0]
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
    movements: dict[str, Movement],
    kernels: dict[str, dict[str, Array]],
    source: str,
    like: Columns,
    products: Callable[[Columns], Float[Array, "*bins blocks columns columns"]],
) -> Float[Array, "*bins blocks columns columns"]:
    """Mean of the products of rows of what a source's noise, sent through, makes of columns."""
    n = like.sample_count
    own = {name: taps[source] for name, taps in kernels.items() if source in taps}
    reach = max(taps.shape[-1] // 2 for taps in own.values())

    def once(signs: Array) -> Array:
        values = jnp.zeros_like(like.values)
        for name in sorted(own.keys() & movements.keys()):
            noise = _filtered(signs.astype(values.dtype), own[name], reach, n)
            values = values + movements[name].scaled(noise).columns(like).values
        return products(Columns(values, like.present, like.time_step, like.parameters))

    place = np.arange(n + 2 * reach) % SIGNS.shape[1]
    return jnp.mean(jax.lax.map(once, jnp.asarray(SIGNS[:, place])), axis=0)


def _filtered(
    signs: Float[Array, " m"], taps: Float[Array, " taps"], reach: int, n: int
) -> Float[Array, " n"]:
    """n samples of white noise, which begins `reach` samples earlier, through a kernel."""
    size = signs.shape[0] + taps.shape[-1]
    spectrum = jnp.fft.rfft(signs, size) * jnp.fft.rfft(taps, size)
    first = reach + taps.shape[-1] // 2
    return jnp.fft.irfft(spectrum, size)[first : first + n]
