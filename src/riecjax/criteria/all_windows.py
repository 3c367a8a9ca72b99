"""The RIEC over every window at once, in closed form.

The sum over all windows of the outer products of their rows is what normal equations need. With
phi the primitive of the equation's columns, a boxcar's row is phi[t + k] - phi[t], and

    sum_{t, k} (phi[t + k] - phi[t]) (phi[t + k] - phi[t])^T
        = sum_u (n[u] + m[u]) phi[u] phi[u]^T - X - X^T,    X = sum_t phi[t] (sum_k phi[t + k])^T

where n[u] windows start at u and m[u] end there. The inner sum is one difference of a running sum
of phi, so the cost is O(N p^2) however many windows there are. A hat's row, phi[t] - 2 phi[t + L] +
phi[t + 2 L], has three such cross terms; its last one sums every second sample. Where lengths do
not count alike, there is one such difference for each bin of lengths that do (see `laws`).

Terms of the sum are as large as phi, which wanders far over a record, and their difference is as
small as a window's change. Starts are therefore taken in blocks, and phi is referred to each block.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from riecjax.criteria.chunks import Blocks
from riecjax.criteria.laws import LagBins
from riecjax.criteria.length_bins import each_bin
from riecjax.criteria.quadrature import running_sum
from riecjax.errors import ModelError
from riecjax.leaves import Leaf


class Starts(NamedTuple):
    """Range of samples at which windows may start."""

    first: Int[Array, ""]
    stop: Int[Array, ""]


class _Runs(NamedTuple):
    """For each sample, the first and last sample of the unbroken run it lies in."""

    first: Int[Array, " n"]
    last: Int[Array, " n"]


class _Sums(NamedTuple):
    """What a bin of lags adds to the moments.

    **Fields:** `inner`, what each sample is multiplied with; `squares`, how many times each sample
    is multiplied with itself; `number` of windows, in all or from each start.
    """

    inner: Float[Array, "columns n"]
    squares: Float[Array, " n"]
    number: Float[Array, "*starts"]


Moments = tuple[Float[Array, "blocks columns columns"], Float[Array, " blocks"]]
"""Sums of outer products of rows, and numbers of rows, for blocks of starts."""


@eqx.filter_custom_jvp
def moments_in_blocks(
    values: Float[Array, "columns n"],
    mean: Float[Array, " columns"],
    present: Bool[Array, " n"] | None,
    lags: LagBins,
    first: Int[Array, ""] | int,
    block: Int[Array, ""] | int,
    held: Int[Array, ""] | int,
    *,
    order: int,
    count: int,
    reach: int,
) -> Moments:
    """Moments of all windows, for `count` blocks of `block` starts each, from `first` on.

    **Arguments:** `values` and `mean` of the columns' primitives, whose differences of order
    `order` (1 for the boxcar, 2 for the hat) are the rows; `present` samples, `None` where all
    are; `lags`, whose edges make it differentiable by alpha and beta, or with two axes, to
    keep the sums of each of the first apart; `held`, how many samples are the record's; `reach`,
    no window is longer in samples.

    **Raises:** `ModelError` when a derivative is differentiated by alpha or beta that was not taken
    by these too.
    """
    lags = lags._replace(edges=None)
    return _of_bins(values, mean, present, lags, first, block, held, order, count, reach)


@moments_in_blocks.def_jvp
def _moments_in_blocks_jvp(primals: Any, tangents: Any, **settings: Any) -> Any:
    """Edges cost two bins each, so they are put among the bins only where they move."""
    edges, moved = primals[3].edges, tangents[3].edges
    moving = moved is not None and moved.position is not None
    if edges is not None and not moving:
        primals = (_at_fixed_edges(primals[0], edges.position), *primals[1:])

    def moments(
        values: Array, mean: Array, present: Array | None, lags: LagBins, *blocks: Any
    ) -> Moments:
        most = settings["reach"] // settings["order"]
        lags = lags.with_edges_as_bins(most) if moving else lags._replace(edges=None)
        return _of_bins(values, mean, present, lags, *blocks, **settings)

    return eqx.filter_jvp(moments, primals, tangents)


@eqx.filter_custom_jvp
def _at_fixed_edges(values: Array, position: Array) -> Array:
    return values


@_at_fixed_edges.def_jvp
def _at_fixed_edges_jvp(primals: Any, tangents: Any) -> tuple[Array, Array | None]:
    if tangents[1] is not None:
        raise ModelError(
            "a derivative of all windows cannot be differentiated by alpha or beta unless it was "
            "taken by them too: differentiate by both at once, as in jax.hessian of a function of "
            "one vector that holds alpha or beta and the rest."
        )
    return primals[0], tangents[0]


def _of_bins(
    values: Float[Array, "columns n"],
    mean: Float[Array, " columns"],
    present: Bool[Array, " n"] | None,
    lags: LagBins,
    first: Int[Array, ""] | int,
    block: Int[Array, ""] | int,
    held: Int[Array, ""] | int,
    order: int,
    count: int,
    reach: int,
) -> Moments:
    if order == 1 and present is None and isinstance(block, int) and reach <= block:
        # Running sums over shorter stretches lose fewer digits; of four windows' length, what
        # they reach beyond themselves is still little to sum twice.
        parts = 1
        while block % (2 * parts) == 0 and block // (2 * parts) >= 4 * reach:
            parts *= 2
        moments, number = unbroken_boxcar_moments(
            values,
            mean,
            lags,
            first=first,
            count=count * parts,
            block=block // parts,
            held=held,
            reach=reach,
        )
        apart = moments.shape[:-3]
        moments = moments.reshape(*apart, count, parts, *moments.shape[-2:])
        return jnp.sum(moments, axis=-3), jnp.sum(number.reshape(*apart, count, parts), axis=-1)
    n = values.shape[1]
    real = jnp.arange(n) < held
    present = real if present is None else present & real
    # Of a block shorter than the longest window, whose size is traced, no more is known.
    width = min((block if isinstance(block, int) else reach) + reach, n)
    of_lags = boxcar_moments if order == 1 else hat_moments

    def of_block(index: Int[Array, ""]) -> tuple[Array, Array]:
        # The last slices would reach beyond the record: they begin earlier instead.
        begin = jnp.clip(first + index * block, 0, n - width)
        part = jax.lax.dynamic_slice_in_dim(values, begin, width, axis=1)
        there = jax.lax.dynamic_slice_in_dim(present, begin, width)
        start = first + index * block - begin
        whole = _referred(part, mean, order)

        def of(own: LagBins) -> tuple[Array, Array]:
            return of_lags(whole, there, Starts(start, start + block), own)

        return each_bin(of, lags)

    moments, number = jax.lax.map(of_block, jnp.arange(count))
    if lags.first.ndim == 1:
        return moments, number
    return jnp.swapaxes(moments, 0, 1), jnp.swapaxes(number, 0, 1)


def _referred(
    values: Float[Array, "columns n"], mean: Float[Array, " columns"], order: int
) -> Float[Array, "columns n"]:
    """Primitives with their polynomial put back, less what their differences do not see.

    That is a constant for first differences and a straight line for second ones.
    """
    n = values.shape[1]
    place = jnp.arange(n) - (n - 1) / 2
    whole = values + mean[:, None] * (place**order / order)[None, :]
    whole = whole - jnp.mean(whole, axis=1, keepdims=True)
    if order == 1:
        return whole
    slope = (whole @ place) / jnp.maximum(jnp.sum(place**2), 1.0)
    return whole - slope[:, None] * place[None, :]


def moments_of_rows(
    rows_of_length: Callable[[Int[Leaf, ""]], tuple[Float[Array, "columns n"], Array]],
    lengths: Int[Leaf, " lengths"],
    weights: Float[Leaf, " lengths"],
    blocks: Blocks,
    *,
    skip_empty: bool = False,
) -> Moments:
    """Moments of rows that start at every sample, summed over some window lengths.

    **Arguments:** `rows_of_length` gives rows at every start, zero where there is no whole window,
    and where there is one; `weights` of the lengths; with `skip_empty` those of weight zero, which
    come last, take no time, and nothing can be differentiated backwards.
    """
    columns = jax.eval_shape(rows_of_length, jnp.asarray(lengths)[0])[0]
    count, room = blocks.number, columns.shape[1]
    # Whole blocks are a reshape; those of a traced size are told apart by where they begin.
    size = blocks.size
    place = (jnp.arange(room) - blocks.first) // size

    def in_blocks(values: Float[Array, "columns n"]) -> Float[Array, "columns count size"]:
        if not isinstance(size, int):
            return jnp.where(
                (place[None, :] == jnp.arange(count)[:, None])[None], values[:, None, :], 0.0
            )
        # Room behind, so that no slice would begin earlier than asked for.
        padded = jnp.pad(values, ((0, 0), (0, count * size)))
        part = jax.lax.dynamic_slice_in_dim(padded, blocks.first, count * size, axis=1)
        return part.reshape(values.shape[0], count, size)

    def added(total: tuple[Array, Array], length: Leaf, weight: Leaf) -> tuple[Array, Array]:
        rows, whole = rows_of_length(length)
        parts = in_blocks(rows)
        number = jnp.sum(in_blocks(whole[None].astype(rows.dtype))[0], axis=1)
        moments = jnp.einsum("ibs,jbs->bij", parts, parts)
        return total[0] + weight * moments, total[1] + weight * number

    empty = jnp.zeros((count, columns.shape[0], columns.shape[0]), columns.dtype)
    none = (empty, jnp.zeros(count, columns.dtype))
    if skip_empty:
        used = jnp.sum(weights > 0)
        return jax.lax.fori_loop(
            0, used, lambda i, total: added(total, lengths[i], weights[i]), none
        )
    return jax.lax.scan(lambda t, which: (added(t, *which), None), none, (lengths, weights))[0]


def unbroken_boxcar_moments(
    values: Float[Array, "columns n"],
    mean: Float[Array, " columns"],
    lags: LagBins,
    *,
    first: Int[Array, ""] | int,
    count: int,
    block: int,
    held: Int[Array, ""] | int,
    reach: int,
) -> Moments:
    """Moments of all boxcar rows, for blocks of starts, where no sample is missing.

    Nothing has to be looked up then: every sum is a running sum, shifted, and what is left of the
    outer products is one matrix product Z over the block, and a shorter one over the windows' ends
    beyond it; the moments are Z + Z^T. All blocks go side by side. `reach` is at most `block`.
    """
    blocks = _side_by_side(values, mean, first, count, block, held, reach)
    start = jnp.arange(block)
    left = held - first - block * jnp.arange(count)[:, None]
    end = jnp.arange(block + reach)

    def of_bin(which: LagBins) -> _Sums:
        def shifted(by: Leaf) -> Array:
            return jax.lax.dynamic_slice_in_dim(blocks.running, by, block, axis=2)

        lags = which.last - which.first + 1
        number = jnp.clip(left - start[None, :] - which.first, 0, lags)
        inner = shifted(which.last + 1) - shifted(which.first)
        # How many windows of a block end at each place.
        earliest = jnp.maximum(end - which.last, 0)
        ends = jnp.maximum(jnp.minimum(end - which.first, block - 1) - earliest + 1, 0)
        return jax.tree.map(
            lambda leaf: which.weight * leaf.astype(values.dtype), _Sums(inner, ends, number)
        )

    own, beyond = blocks.phi[:, :, :block], blocks.phi[:, :, block:]

    def of_lags(some: LagBins) -> Moments:
        total = _over_bins(some, of_bin)
        weight = 0.5 * (total.number + total.squares[None, :block])
        half = _products(own, weight[None] * own - total.inner)
        half = half + _products(beyond, 0.5 * total.squares[None, None, block:] * beyond)
        return half + jnp.swapaxes(half, 1, 2), jnp.sum(total.number, axis=1)

    return each_bin(of_lags, lags)


class _Blocks(NamedTuple):
    """Blocks of starts, each with the samples beyond it that its windows reach.

    **Fields:** `phi`, referred to the block's mean, zero beyond the record; `running`, the sum of
    phi over the block's samples before each.
    """

    phi: Float[Array, "columns blocks reached"]
    running: Float[Array, "columns blocks 1+reached"]


def _side_by_side(
    values: Float[Array, "columns n"],
    mean: Float[Array, " columns"],
    first: Int[Array, ""] | int,
    count: int,
    block: int,
    held: Int[Array, ""] | int,
    reach: int,
) -> _Blocks:
    """Primitives with their polynomial put back, in blocks.

    A block and the beginning of the next one are what its windows see. The next one's running sum
    is taken over from there, with the constant by which the two references differ.
    """
    columns = values.shape[0]
    whole = (count + 1) * block
    padded = jnp.pad(values, ((0, 0), (0, whole)))
    parts = jax.lax.dynamic_slice_in_dim(padded, first, whole, axis=1)
    parts = parts.reshape(columns, count + 1, block)
    held = jnp.clip(held - first - block * jnp.arange(count + 1), 0, block)
    inside = jnp.arange(block)[None, :] < held[:, None]
    place = jnp.arange(block) - (block - 1) / 2
    parts = jnp.where(inside[None], parts + mean[:, None, None] * place[None, None, :], 0.0)
    reference = jnp.sum(parts, axis=2) / jnp.maximum(held, 1)[None, :]
    parts = jnp.where(inside[None], parts - reference[:, :, None], 0.0)
    running = running_sum(parts.reshape(-1, block)).reshape(parts.shape)
    total = running[:, :-1, -1:]
    step = (jnp.diff(reference, axis=1) + block * mean[:, None])[:, :, None]
    further = jnp.where(inside[None, 1:, :reach], parts[:, 1:, :reach] + step, 0.0)
    counted = jnp.minimum(jnp.arange(1, reach + 1)[None, :], held[1:, None])
    beyond = total + running[:, 1:, :reach] + step * counted[None]
    running = jnp.concatenate([jnp.zeros_like(total), running[:, :-1], beyond], axis=2)
    return _Blocks(jnp.concatenate([parts[:, :-1], further], axis=2), running)


def _products(
    one: Float[Array, "columns blocks samples"], other: Float[Array, "columns blocks samples"]
) -> Float[Array, "blocks columns columns"]:
    return jnp.einsum("ibs,jbs->bij", one, other, precision=jax.lax.Precision.HIGHEST)


def boxcar_moments(
    phi: Float[Array, "columns n"], present: Bool[Array, " n"], starts: Starts, bins: LagBins
) -> tuple[Float[Array, "columns columns"], Float[Array, ""]]:
    """Sum of the outer products of all boxcar rows, and their number."""
    at, runs, begins = _places(present, starts)

    def of_bin(shortest: Int[Leaf, ""], longest: Int[Leaf, ""]) -> _Sums:
        last = jnp.minimum(at + longest, runs.last)
        count = jnp.where(begins, jnp.maximum(last - at - shortest + 1, 0), 0)
        inner = jnp.where((count > 0)[None, :], _between(phi, at + shortest, last), 0.0)
        ending = _starts_between(begins, jnp.maximum(at - longest, runs.first), at - shortest)
        return _sums(-inner, count + jnp.where(present, ending, 0), count)

    return _moments(phi, bins, of_bin)


def hat_moments(
    phi: Float[Array, "columns n"], present: Bool[Array, " n"], starts: Starts, bins: LagBins
) -> tuple[Float[Array, "columns columns"], Float[Array, ""]]:
    """Sum of the outer products of all hat rows, and their number."""
    at, runs, begins = _places(present, starts)

    def of_bin(shortest: Int[Leaf, ""], longest: Int[Leaf, ""]) -> _Sums:
        # From the start: L up to the longest, with the end at t + 2 L inside the run.
        reach = jnp.minimum(longest, (runs.last - at) // 2)
        count = jnp.where(begins, jnp.maximum(reach - shortest + 1, 0), 0)
        some = (count > 0)[None, :]
        middles = jnp.where(some, _between(phi, at + shortest, at + reach), 0.0)
        ends = jnp.where(some, _every_second(phi, at + 2 * shortest, at + 2 * reach), 0.0)
        # From the middle u: the start u - L and the end u + L in the run, the start in the range.
        low = jnp.maximum(shortest, at - starts.stop + 1)
        high = jnp.minimum(longest, runs.last - at)
        high = jnp.minimum(high, at - jnp.maximum(runs.first, starts.first))
        held = present & (high >= low)
        middle_count = jnp.where(held, high - low + 1, 0)
        beyond = jnp.where(held[None, :], _between(phi, at + low, at + high), 0.0)
        # From the end v: starts v - 2 L of the run and the range.
        ending = _every_second_start(
            begins, jnp.maximum(at - 2 * longest, runs.first), at - 2 * shortest
        )
        squares = count + 4 * middle_count + jnp.where(present, ending, 0)
        return _sums(ends - 2 * middles - 2 * beyond, squares, count)

    return _moments(phi, bins, of_bin)


def _sums(inner: Array, squares: Int[Array, " n"], count: Int[Array, " n"]) -> _Sums:
    # Windows are counted in real numbers: a long record's are more than 32-bit integers hold.
    return _Sums(inner, squares.astype(inner.dtype), jnp.sum(count, dtype=inner.dtype))


def _moments(
    phi: Float[Array, "columns n"], bins: LagBins, of_bin: Callable[[Leaf, Leaf], _Sums]
) -> tuple[Float[Array, "columns columns"], Float[Array, ""]]:
    def weighted(which: LagBins) -> _Sums:
        return jax.tree.map(lambda leaf: which.weight * leaf, of_bin(which.first, which.last))

    total = _over_bins(bins, weighted)
    cross = phi @ total.inner.T
    return (phi * total.squares[None, :]) @ phi.T + cross + cross.T, total.number


def _over_bins(bins: LagBins, of_bin: Callable[[LagBins], _Sums]) -> _Sums:
    """What all bins add up to."""

    def add(total: _Sums, which: LagBins) -> tuple[_Sums, None]:
        return jax.tree.map(jnp.add, total, of_bin(which)), None

    total = of_bin(jax.tree.map(lambda values: values[0], bins))
    if bins.first.shape[0] == 1:
        return total
    # Backwards each bin is computed again, rather than all of them kept.
    rest = jax.tree.map(lambda values: values[1:], bins)
    return jax.lax.scan(jax.checkpoint(add), total, rest)[0]


def _places(
    present: Bool[Array, " n"], starts: Starts
) -> tuple[Int[Array, " n"], _Runs, Bool[Array, " n"]]:
    """Every sample, the run it lies in, and whether windows may start there."""
    n = present.shape[0]
    at = jnp.arange(n)
    gap_before = jax.lax.cummax(jnp.where(present, -1, at))
    gap_after = jax.lax.cummin(jnp.where(present, n, at), reverse=True)
    begins = present & (at >= starts.first) & (at < starts.stop)
    return at, _Runs(gap_before + 1, gap_after - 1), begins


def _between(
    phi: Float[Array, "columns n"], first: Int[Array, " n"], last: Int[Array, " n"]
) -> Float[Array, "columns n"]:
    """Sum of phi from the sample `first` to the sample `last`, both included."""
    n = phi.shape[1]
    running = jnp.pad(running_sum(phi), ((0, 0), (1, 0)))
    return running[:, jnp.clip(last + 1, 0, n)] - running[:, jnp.clip(first, 0, n)]


def _every_second(
    phi: Float[Array, "columns n"], first: Int[Array, " n"], last: Int[Array, " n"]
) -> Float[Array, "columns n"]:
    """Sum of phi over `first`, `first + 2`, ... `last`, which are of one parity."""
    running = _running_every_second(phi)
    end = phi.shape[1] + 1
    return running[:, jnp.clip(last + 2, 0, end)] - running[:, jnp.clip(first, 0, end)]


def _running_every_second(values: Float[Array, "columns n"]) -> Float[Array, "columns n+2"]:
    """At i + 2, the sum of values at i, i - 2, i - 4, ..."""
    columns, n = values.shape
    padded = jnp.pad(values, ((0, 0), (2, n % 2)))
    return jnp.cumsum(padded.reshape(columns, -1, 2), axis=1).reshape(columns, -1)[:, : n + 2]


def _starts_between(
    begins: Bool[Array, " n"], first: Int[Array, " n"], last: Int[Array, " n"]
) -> Int[Array, " n"]:
    """How many starts lie from `first` to `last`."""
    n = begins.shape[0]
    running = jnp.pad(jnp.cumsum(begins), (1, 0))
    number = running[jnp.clip(last + 1, 0, n)] - running[jnp.clip(first, 0, n)]
    return jnp.where(last >= first, number, 0)


def _every_second_start(
    begins: Bool[Array, " n"], first: Int[Array, " n"], last: Int[Array, " n"]
) -> Int[Array, " n"]:
    """How many starts lie at `last`, `last - 2`, ... down to `first` at least."""
    n = begins.shape[0]
    running = _running_every_second(begins.astype(jnp.int32)[None, :])[0]
    # The lowest sample of last's parity that is not below first.
    lowest = first + (last - first) % 2
    number = running[jnp.clip(last + 2, 0, n + 1)] - running[jnp.clip(lowest, 0, n + 1)]
    return jnp.where(last >= lowest, number, 0)
